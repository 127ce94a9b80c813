"""The ground truth of edits on a street, frame by frame: what a scenario's cameras and LiDARs see, and which pixels the
scenario's edits change."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from unisim_blender.core.data.images import resize_image
from unisim_blender.core.evaluation.ground_truth import TrueImages, Version
from unisim_blender.core.evaluation.metrics import ImageArray
from unisim_blender.core.evaluation.truth import EditRegions
from unisim_blender.core.prepare.scenario import PreparedScenario
from unisim_blender.core.sensors.frames import LidarFrame
from unisim_blender.core.world.drive import Drive

from .drawing.path_tracer import TruthRequest, draw_truths
from .drawing.true_images import lacks_images, true_image
from .drive_street import street_of
from .edit_masks import edit_masks
from .street import RECIPE_FILE, Street, load_street, recipe_document
from .truth import resize, truth_camera, truth_lidar
from .usual_edits import FOLDER, write_scenarios


@dataclass(frozen=True)
class StreetTruth:
    """A scenario on the street at ``path``: the drive as it was recorded and edited, with the log's own poses; the
    frames and cameras that count as seen; the images' width."""

    path: Path
    street: Street
    recorded: Drive
    edited: Drive
    trained_frames: tuple[int, ...]
    trained_cameras: tuple[str, ...]
    width: int | None

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


@dataclass(frozen=True)
class KnownStreet:
    """The street whose log is at ``path``; see `KnownLog`."""

    path: Path
    street: Street

    @property
    def name(self) -> str:
        """See `KnownLog.name`."""
        return self.street.drive.name

    @property
    def recipe(self) -> dict[str, Any]:
        """See `KnownLog.recipe`."""
        document: dict[str, Any] = json.loads(json.dumps(recipe_document(self.street.recipe)))
        return document

    def truth(
        self, prepared: PreparedScenario, frames: tuple[int, ...], cameras: tuple[str, ...], width: int | None
    ) -> StreetTruth:
        """See `KnownLog.truth`."""
        seen = tuple(name for name in cameras if name in prepared.recorded.cameras)
        street = street_of(self.street, prepared.scenes.others(prepared.edited))
        return StreetTruth(self.path, street, prepared.recorded, prepared.edited, frames, seen, width)

    def usual_edits(self, out: Path) -> tuple[Path, ...]:
        """See `KnownLog.usual_edits`."""
        return tuple(sorted((self.path / FOLDER).glob("*.json"))) or write_scenarios(self.street, out, self.path)


class KnownStreets:
    """Logs of procedural streets; see `KnownLogs`."""

    name: ClassVar[str] = "street"

    @staticmethod
    def recognises(path: Path) -> bool:
        """See `KnownLogs.recognises`."""
        return (path / RECIPE_FILE).is_file()

    @staticmethod
    def open(path: Path) -> KnownStreet:
        """See `KnownLogs.open`."""
        return KnownStreet(path, load_street(path))
