"""What a path tracer draws for one image of a drive: models, where they are while the shutter
passes, and the camera."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.sensors.camera import line_count, line_times
from unisim_blender.core.sensors.silhouettes import view_half_angle
from unisim_blender.core.world.drive import Camera, Drive

from ..street import EGO_REACH_M, Street
from ..tracing.trace import Asset, AssetPlacement
from ..truth import resize
from ..world import make_world
from .atlas import AssetModel, Detail, Eyes, painted
from .cut import inside, outside

SHUTTER_KEYS = 5
"""Poses between the first line's exposure and the last one's, both included."""
_TEXEL_PIXELS, _GROUND_TEXEL_PIXELS = 2.0, 1.0
"""Pixels that a texel covers where a camera is nearest. Finer paint would be noise further off; the
ground is seen aslant."""
_NEAR_M, _ACTOR_NEAR_M = 5.0, 4.0
_MARGIN_RAD = 0.15
"""Room beside a recorded view for one that is turned."""


@dataclass(frozen=True, eq=False)
class DrawnModel:
    """A model in an image: poses (K, 4, 4) street frame at `SHUTTER_KEYS` even times, one where it stands still; scale
    (3,), how many times larger than the model it is along its own axes."""

    name: str
    model: AssetModel
    poses: FloatArray
    scale: FloatArray = field(default_factory=lambda: np.ones(3))


@dataclass(frozen=True, eq=False)
class ImageSetup:
    """One image: its items, the camera with the image's size, and its poses (K, 4, 4), street frame."""

    items: list[DrawnModel]
    camera: Camera
    poses: FloatArray


@dataclass
class Workshop:
    """Paints assets, each once, and sets up images of drives through a street."""

    street: Street
    _models: dict[Asset, AssetModel] = field(default_factory=dict)
    _cut: dict[tuple[object, ...], AssetModel] = field(default_factory=dict)

    def image_setup(self, drive: Drive, camera_id: str, frame: int, width: int | None = None) -> ImageSetup:
        """An image of a drive. Who comes or goes while the shutter passes is there if the middle line sees it."""
        world = make_world(self.street, drive)
        camera = resize(drive.cameras[camera_id], width)
        times = shutter_times(camera, frame)
        middle = float(times[SHUTTER_KEYS // 2])
        items = []
        for placement in world.placements:
            if placement.window is not None and not placement.window[0] <= middle <= placement.window[1]:
                continue
            model = self._model(placement)
            if len(model.corners):
                scale = np.ones(3) if placement.scale is None else placement.scale
                items.append(DrawnModel(placement.name, model, _poses(placement, times), scale))
        return ImageSetup(items, camera, world.street_from_world @ camera.world_from_camera.at(times))

    def _model(self, placement: AssetPlacement) -> AssetModel:
        asset = placement.asset
        if asset not in self._models:
            self._models[asset] = painted(asset, self._detail(asset))
        model = self._models[asset]
        boxes = placement.holes if placement.clip is None else (placement.clip,)
        if not boxes:
            return model
        # an edited drive is set up for many images: what its boxes leave is worked out once
        key = (
            asset,
            placement.clip is None,
            *(box.world_from_box.tobytes() + np.asarray(box.size_m).tobytes() for box in boxes),
        )
        if key not in self._cut:
            self._cut[key] = outside(model, boxes) if placement.clip is None else inside(model, boxes[0])
        return self._cut[key]

    def _detail(self, asset: Asset) -> Detail:
        cameras = self.street.drive.cameras.values()
        pixels = _GROUND_TEXEL_PIXELS if asset is self.street.ground else _TEXEL_PIXELS
        texel_rad = pixels / max(camera.model.pixels_per_rad for camera in cameras)
        if asset not in (self.street.ground, self.street.static):
            return Detail(texel_rad, _ACTOR_NEAR_M)
        return Detail(texel_rad, _NEAR_M, self._eyes())

    def _eyes(self) -> Eyes:
        """The recorded views, and those beside and behind them that an edited drive may have."""
        places, axes, angles = [], [], []
        for camera in self.street.drive.cameras.values():
            poses = camera.world_from_camera.poses
            model = camera.model
            for left in (-EGO_REACH_M, 0.0, EGO_REACH_M):
                places.append(poses[:, :3, 3] + self.street.drive.world_origin + [0.0, left, 0.0])
                axes.append(poses[:, :3, 2])
                if model.is_pinhole:
                    half = np.arctan(np.hypot(model.width / model.fx, model.height / model.fy) / 2)
                else:
                    half = view_half_angle(model, 0.0)
                angles.append(np.full(len(poses), half + _MARGIN_RAD))
        return Eyes(*(np.concatenate(column) for column in (places, axes, angles)))


def _poses(placement: AssetPlacement, times: FloatArray) -> FloatArray:
    if placement.motion is None:
        return np.eye(4)[None]
    if len(placement.motion.times_s) == 1:
        return placement.motion.poses
    return placement.motion.at(times)


def shutter_times(camera: Camera, frame: int) -> FloatArray:
    """Even times (`SHUTTER_KEYS`,) over an image's exposure. Cycles gives a line the time at which its lower edge lies between
    the first and the last, the camera's model that of its middle: these are half a line early."""
    return line_times(camera, camera.time_s[frame], np.linspace(0, line_count(camera.model), SHUTTER_KEYS) - 0.5)
