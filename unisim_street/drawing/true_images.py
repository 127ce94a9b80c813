"""Images of edited drives that Cycles has drawn, kept in the street's own folder, each under a name that
says what it shows.

An image's name holds a digest of all that it depends on, so that drives that look alike at a moment share theirs, and
an edit that changes anything asks for a new one.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.errors import OutputError
from unisim_blender.core.files import write_file
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.world.drive import Drive

from ..street import Street, recipe_document
from ..truth import resize
from ..world import make_world
from .image_setup import shutter_times

FOLDER = "truth"
_DIGITS = 6
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
        "street": {name: recipe[name] for name in ("seed", "frames", "width", "engine", "paths", "cameras")},
        "camera": [model.width, model.height, model.fx, model.fy, model.cx, model.cy, model.shutter.duration_s],
        **({} if model.is_pinhole else {"lens": model.lens.to_dict()}),
        **({"axis": "columns"} if model.shutter.axis == "columns" else {}),
        "poses": _rounded(world.street_from_world @ camera.world_from_camera.at(times)),
        "lies": sorted(lies, key=json.dumps),
    }
    digest = hashlib.sha256(json.dumps(shows, sort_keys=True).encode()).hexdigest()[:16]
    return folder / FOLDER / camera_id / f"{frame:06d}-{digest}.png"


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
    return (np.round(np.asarray(values, np.float64), _DIGITS) + 0.0).tolist()
