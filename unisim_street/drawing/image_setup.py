"""The setup of one image of a drive for a path tracer: models, where they are while the shutter passes, and the camera; and the
images of edited drives that Cycles has drawn.

These lie in the street's own folder. Their names hold a digest of all that they depend on, so that drives that look alike at a
moment share theirs, and an edit that changes anything asks for a new one.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.errors import OutputError
from unisim_blender.core.files import write_file
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.sensors.camera import line_count, line_times
from unisim_blender.core.sensors.silhouettes import view_half_angle
from unisim_blender.core.world.drive import Camera, Drive

from ..street import FINE_PAINT_REACH_M, Street, recipe_document
from ..tracing.trace import Asset, AssetPlacement
from ..truth import make_world, resize
from .atlas import AssetModel, Detail, Eyes, inside, outside, painted

SHUTTER_KEYS = 5
"""Poses between the first line's exposure and the last one's, both included."""
_TEXEL_PIXELS, _GROUND_TEXEL_PIXELS = 2.0, 1.0
"""Pixels that a texel covers where a camera is nearest. Finer paint would be noise further off; the
ground is seen aslant."""
_GROUND_NEAR_M, _ACTOR_NEAR_M = 5.0, 4.0
_VIEW_MARGIN_RAD = 0.15
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
        return Detail(texel_rad, _GROUND_NEAR_M, self._eyes())

    def _eyes(self) -> Eyes:
        """The recorded views, and those beside and behind them that an edited drive may have."""
        places, axes, angles = [], [], []
        for camera in self.street.drive.cameras.values():
            poses = camera.world_from_camera.poses
            model = camera.model
            for left in (-FINE_PAINT_REACH_M, 0.0, FINE_PAINT_REACH_M):
                places.append(poses[:, :3, 3] + self.street.drive.world_origin + [0.0, left, 0.0])
                axes.append(poses[:, :3, 2])
                if model.is_pinhole:
                    half = np.arctan(np.hypot(model.width / model.fx, model.height / model.fy) / 2)
                else:
                    half = view_half_angle(model, 0.0)
                angles.append(np.full(len(poses), half + _VIEW_MARGIN_RAD))
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


TRUTH_FOLDER = "truth"
_POSE_DECIMALS = 6
"""Decimals of metres and of rotation matrices by which poses differ."""


def true_image_path(folder: Path, street: Street, drive: Drive, camera_id: str, frame: int, width: int | None) -> Path:
    """Where an image of a drive through the street at ``folder`` is kept. Raises `ScenarioError` for
    unknown appearances."""
    world = make_world(street, drive)
    camera = resize(drive.cameras[camera_id], width)
    times = shutter_times(camera, frame)
    lies = []
    for placement in world.placements:
        if placement.window is not None and not placement.window[0] <= times[len(times) // 2] <= placement.window[1]:
            continue
        boxes = [*placement.holes, *([placement.clip] if placement.clip is not None else [])]
        lies.append(
            {
                "asset": _asset_name(street, placement.asset),
                "poses": [] if placement.motion is None else _rounded(placement.motion.at(times)),
                "clipped": placement.clip is not None,
                "boxes": [[_rounded(box.world_from_box), _rounded(np.asarray(box.size_m))] for box in boxes],
                **({} if placement.scale is None else {"scale": _rounded(placement.scale)}),
            }
        )
    recipe = recipe_document(street.recipe)
    model = camera.model_at(camera.time_s[frame])
    shows: dict[str, Any] = {
        "street": {
            name: recipe[name]
            for name in ("seed", "frames", "width", "engine", "paths", "cameras", "kind")
            if name in recipe
        },
        "camera": [model.width, model.height, model.fx, model.fy, model.cx, model.cy, model.shutter.duration_s],
        **({} if model.is_pinhole else {"lens": model.lens.to_dict()}),
        **({"axis": "columns"} if model.shutter.axis == "columns" else {}),
        "poses": _rounded(world.street_from_world @ camera.world_from_camera.at(times)),
        "lies": sorted(lies, key=json.dumps),
    }
    digest = hashlib.sha256(json.dumps(shows, sort_keys=True).encode()).hexdigest()[:16]
    return folder / TRUTH_FOLDER / camera_id / f"{frame:06d}-{digest}.png"


def lacks_images(
    folder: Path,
    street: Street,
    drives: Sequence[Drive],
    cameras: Sequence[str],
    frames: Sequence[int],
    width: int | None,
) -> bool:
    """Whether some image of the drives is yet to be drawn; never of a street that draws its own."""
    return street.recipe.engine != "exact" and any(
        not true_image_path(folder, street, drive, name, frame, width).exists()
        for drive, name, frame in shown(drives, cameras, frames)
    )


def shown(drives: Sequence[Drive], cameras: Sequence[str], frames: Sequence[int]) -> Iterator[tuple[Drive, str, int]]:
    """The images that drives have, of those cameras at those frames."""
    for drive in drives:
        for name in cameras:
            for frame in frames:
                if name in drive.cameras and frame in drive.cameras[name].time_s:
                    yield drive, name, frame


def true_image(
    folder: Path, street: Street, drive: Drive, camera_id: str, frame: int, width: int | None
) -> NDArray[np.uint8]:
    """The image (H, W, 3), sRGB. Raises `OutputError` where it was not drawn yet."""
    from PIL import Image

    path = true_image_path(folder, street, drive, camera_id, frame, width)
    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"))
    except FileNotFoundError as error:
        raise OutputError(f"{path}: this image of {drive.name} is not drawn yet") from error


def keep_image(path: Path, rgb: NDArray[np.uint8]) -> None:
    """Write an image (H, W, 3), sRGB."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(rgb).save(buffer, "PNG")
    write_file(path, buffer.getvalue())


def _asset_name(street: Street, asset: Any) -> str:
    """An asset's name, with its street's where that is another."""
    for scene, other in street.others.items():
        if asset in other.assets.values() and other is not street:
            return f"{scene}:{other.recipe.seed}:{asset.name}"
    return str(asset.name)


def _rounded(values: FloatArray) -> list[Any]:
    return (np.round(np.asarray(values, np.float64), _POSE_DECIMALS) + 0.0).tolist()
