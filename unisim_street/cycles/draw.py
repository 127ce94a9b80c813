"""Drawing of a street's missing images, one after the other."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.formats.pandaset.sensors import CAMERAS
from unisim_blender.core.formats.pandaset.write import PandasetWriter
from unisim_blender.core.prepare.scenario import prepare_scenario
from unisim_blender.core.world.drive import Drive

from ..drawing.image_setup import Workshop, keep_image, shown, true_image_path
from ..drawing.path_tracer import Order, TruthRequest
from ..street import Street, load_street, street_of
from .painter import CyclesPainter

Say = Callable[..., None]
Keep = Callable[[NDArray[np.uint8]], None]


def draw(order: Order, say: Say) -> None:
    """Draw an order's images that are not there yet, and say after each that it is done. Raises `UnisimError`."""
    jobs = log_jobs(order.out) if order.truths is None else truth_jobs(order.out, order.truths, order.width)
    say(total=len(jobs))
    studio = None
    for job in jobs:
        if studio is None or studio.workshop.street is not job.street:
            studio = Studio(job.street)
        job.keep(studio.image(job.drive, job.camera, job.frame, job.width))
        say(done=f"{job.camera} {job.frame}")


class DrawJob:
    """One image to draw, and what keeps it."""

    def __init__(self, street: Street, drive: Drive, camera: str, frame: int, width: int | None, keep: Keep) -> None:
        self.street, self.drive, self.camera, self.frame, self.width, self.keep = (
            street,
            drive,
            camera,
            frame,
            width,
            keep,
        )


def log_jobs(out: Path) -> list[DrawJob]:
    """The images that the log at ``out`` lacks."""
    street = load_street(out)
    writer = PandasetWriter(out, street.drive)

    def keep(name: str, frame: int) -> Keep:
        return lambda rgb: writer.write_image(name, frame, rgb)

    return [
        DrawJob(street, street.drive, name, frame, None, keep(name, frame))
        for frame in street.drive.frames
        for name in street.drive.cameras
        if not writer.image_path(name, frame).exists()
    ]


def truth_jobs(out: Path, truths: tuple[TruthRequest, ...], width: int | None) -> list[DrawJob]:
    """Images of scenarios' edited drives and of the unedited one, where ``out`` lacks them; each once."""
    jobs: dict[Path, DrawJob] = {}
    recorded = load_street(out)
    for wanted in truths:
        prepared = prepare_scenario(wanted.scenario, refined=False)
        street = street_of(recorded, prepared.scenes.others(prepared.edited))
        for drive, name, frame in shown((prepared.edited, prepared.recorded), wanted.cameras, wanted.frames):
            path = true_image_path(out, street, drive, name, frame, width)
            if not path.exists() and path not in jobs:
                jobs[path] = DrawJob(street, drive, name, frame, width, _keeper(path))
    return list(jobs.values())


def _keeper(path: Path) -> Keep:
    return lambda rgb: keep_image(path, rgb)


def noise_seed(camera: str, frame: int) -> int:
    """The seed of an image's noise: each has its own, alike for all drives, so that an edit's images
    differ by the edit."""
    return 1 + CAMERAS.index(camera) + len(CAMERAS) * frame if camera in CAMERAS else 0


class Studio:
    """A street's workshop and its painter."""

    def __init__(self, street: Street) -> None:
        self.workshop = Workshop(street)
        self._painter = CyclesPainter(street.recipe.paths, street.light)

    def image(self, drive: Drive, camera: str, frame: int, width: int | None = None) -> NDArray[np.uint8]:
        """An image (H, W, 3), sRGB."""
        return self._painter.paint(self.workshop.image_setup(drive, camera, frame, width), noise_seed(camera, frame))
