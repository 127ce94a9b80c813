"""What a scenario's cameras and LiDARs truly see of a street, frame by frame, and which pixels the
scenario's edits change."""

from __future__ import annotations

import io
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..data.images import resize_image
from ..errors import OutputError
from ..files import read_arrays, write_file
from ..prepare.scenario import PreparedScenario
from ..prepare.street import street_of
from ..sensors.frames import LidarFrame
from ..street.drawing.path_tracer import TruthRequest, draw_truths
from ..street.drawing.true_images import lacks_images, true_image
from ..street.edit_masks import edit_masks
from ..street.street import Street, load_street
from ..street.truth import resize, truth_camera, truth_lidar
from ..world.drive import Drive
from .metrics import ImageArray
from .truth import EditRegions

Version = Literal["edit", "replay"]


@dataclass(frozen=True)
class TrueImages:
    """A camera's true images (H, W, 3) of one frame: of the edit, of the recorded drive where that has the camera, and
    the regions of the edit's."""

    edit: ImageArray
    replay: ImageArray | None
    regions: EditRegions


@dataclass(frozen=True)
class TrueEdit:
    """A scenario on the street at ``path``: the drive as it was recorded and edited, with the log's own poses; the
    frames and cameras that count as seen; the images' width."""

    path: Path
    street: Street
    recorded: Drive
    edited: Drive
    trained_frames: tuple[int, ...]
    trained_cameras: tuple[str, ...]
    width: int | None

    @staticmethod
    def on(
        path: Path, prepared: PreparedScenario, frames: tuple[int, ...], cameras: tuple[str, ...], width: int | None
    ) -> TrueEdit:
        """Of a scenario that was prepared with the log's own poses, for those who learnt from frames of cameras. Raises
        `UnisimError`."""
        there = tuple(name for name in cameras if name in prepared.recorded.cameras)
        return TrueEdit(
            path,
            street_of(load_street(path), prepared.scenes.others(prepared.edited)),
            prepared.recorded,
            prepared.edited,
            frames,
            there,
            width,
        )

    def draw(self, scenario: Path, frames: tuple[int, ...], cameras: tuple[str, ...]) -> None:
        """Have the images drawn that only a path tracer can draw, and that are not there. Raises `UnisimError`."""
        if lacks_images(self.path, self.street, (self.edited, self.recorded), cameras, frames, self._drawn_width):
            draw_truths(self.path, (TruthRequest(scenario, frames, cameras),), self._drawn_width, progress=True)

    def images(self, camera: str, frame: int) -> TrueImages:
        """What a camera sees. Raises `UnisimError`."""
        masks = edit_masks(
            self.street,
            self.recorded,
            self.edited,
            camera,
            frame,
            self.trained_frames,
            self.trained_cameras or None,
            self.width,
        )
        return TrueImages(
            self.image("edit", camera, frame),
            self.image("replay", camera, frame) if camera in self.recorded.cameras else None,
            EditRegions(masks.edited, masks.shadow, masks.seen),
        )

    def image(self, version: Version, camera: str, frame: int) -> ImageArray:
        """What a camera of the drive sees (H, W, 3), drawn now, or by Cycles before. Raises `UnisimError`."""
        drive = self.drive(version)
        if self.street.recipe.engine == "exact":
            return truth_camera(self.street, drive, camera, frame, self.width).rgb
        drawn = true_image(self.path, self.street, drive, camera, frame, self._drawn_width)
        return resize_image(drawn, resize(drive.cameras[camera], self.width).model).astype(np.float32) / np.float32(255)

    def sweep(self, version: Version, lidar: str, frame: int) -> LidarFrame | None:
        """What a LiDAR sees, with exact ranges; None of a recorded drive that has no such LiDAR."""
        drive = self.drive(version)
        return truth_lidar(self.street, drive, lidar, frame) if lidar in drive.lidars else None

    def drive(self, version: Version) -> Drive:
        """The drive, as edited or as recorded."""
        return self.edited if version == "edit" else self.recorded

    @property
    def _drawn_width(self) -> int | None:
        """The width at which Cycles draws: the cameras' own, and smaller images are made of those as of recorded ones,
        so they are as sharp and need not be drawn again; only what is wider is drawn wider."""
        own = min((camera.model.width for camera in self.edited.cameras.values()), default=0)
        return None if self.width is None or self.width <= own else self.width


Arrays = dict[str, NDArray[Any]]
REGION_MASKS = ("edited", "shadow", "seen")


@dataclass(frozen=True)
class CachedTruth:
    """`TrueEdit` whose images are computed once and stored in ``folder``, which is for this truth alone; its files may be
    deleted at any time."""

    true: TrueEdit
    folder: Path

    def drive(self, version: Version) -> Drive:
        """See `TrueEdit.drive`."""
        return self.true.drive(version)

    def images(self, camera: str, frame: int) -> TrueImages:
        """See `TrueEdit.images`."""

        def compute() -> Arrays:
            true = self.true.images(camera, frame)
            regions = {name: getattr(true.regions, name) for name in REGION_MASKS}
            return {"edit": true.edit, **regions, **({} if true.replay is None else {"replay": true.replay})}

        arrays = _cached(self.folder / f"{camera}-{frame:06d}.npz", compute)
        return TrueImages(
            arrays["edit"], arrays.get("replay"), EditRegions(arrays["edited"], arrays["shadow"], arrays["seen"])
        )

    def sweep(self, version: Version, lidar: str, frame: int) -> LidarFrame | None:
        """See `TrueEdit.sweep`: sweeps are quick to trace."""
        return self.true.sweep(version, lidar, frame)


def _cached(path: Path, compute: Callable[[], Arrays]) -> Arrays:
    with suppress(OutputError):
        arrays = read_arrays(path, OutputError)
        if _are_an_edit(arrays):
            return arrays
    arrays = compute()
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    write_file(path, file.getvalue())
    return arrays


def _are_an_edit(arrays: Arrays) -> bool:
    """Return whether arrays are an edit's images and regions."""
    if not {"edit", *REGION_MASKS} <= set(arrays) or arrays["edit"].ndim != 3:
        return False
    images = [arrays[name] for name in ("edit", "replay") if name in arrays]
    size = images[0].shape[:2]
    whole = all(image.shape == (*size, 3) and image.dtype in (np.uint8, np.float32, np.float64) for image in images)
    return whole and all(arrays[name].shape == size and arrays[name].dtype == bool for name in REGION_MASKS)
