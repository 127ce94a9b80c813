"""Portraits of a trained scene's actors: requests to the worker for a view from where an actor was recorded best,
without other actors; collected as they come from the worker, and kept in the cache folder."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...core.actor_images.best_views import best_views, png
from ...core.files import cache_folder, write_file
from ...core.geometry import box_corners, invert_pose, transform_points
from ...core.model.scene_file import HEADER_NAME
from ...core.world.drive import Actor, CameraModel
from ..reading.requests import CameraRequest, camera_request
from ..sampled.clock import Clock, recorded_poses, recorded_there
from ..sampled.scene import Sampled, SampledObject, optical
from ..sampled.source import DriveSource

SIZE_PX = 192
MOST_TRIED = 20
"""Number of frames of a camera among which the view is chosen: a wide lens takes long."""
FILLED = 0.9
"""Fraction of the image's width or height that the actor fills."""
FAR_SIZES = 3.0
"""Distance of the camera from the actor's centre, in diagonals of its box."""


def portrait_request(source: DriveSource, actor: Actor, name: str) -> CameraRequest | None:
    """Return the request for a portrait; None for an actor that no camera came near. No other actor is there."""
    clock = Clock.of(source.drive)
    times = {name: tuple(camera.time_s) for name, camera in source.drive.cameras.items()}
    tried = {name: frames[:: -(-len(frames) // MOST_TRIED) or 1] for name, frames in times.items()}
    views = best_views(replace(source.drive, actors={actor.uid: actor}), tried, 1)[actor.uid]
    if not views:
        return None
    frame, centre, size = views[0].frame, views[0].pose[:3, 3], float(np.linalg.norm(actor.size_m))
    ahead = centre - views[0].camera_pose[:3, 3]
    ahead /= np.linalg.norm(ahead)
    eye = centre - ahead * FAR_SIZES * size
    back = -ahead
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(back, right), back], 1)  # Blender's axes: a camera looks along -z
    pose[:3, 3] = eye
    at = recorded_poses(actor, clock)[int(np.searchsorted(clock.frames, frame))]
    seen_from = transform_points(invert_pose(optical(pose)), box_corners(at, actor.size_m))
    focal = FILLED * SIZE_PX / 2 / np.abs(seen_from[:, :2] / seen_from[:, 2:]).max()
    model = CameraModel(SIZE_PX, SIZE_PX, focal, focal, SIZE_PX / 2, SIZE_PX / 2)
    here = clock.around(frame)
    count = len(here.frames)
    view = SampledObject(
        "portrait", "NONE", "", "", "", "", "", 0, np.repeat(pose[None], count, 0), np.ones(count, bool), model
    )
    # nothing else stands in front of it
    poses, there = recorded_poses(actor, here), recorded_there(actor, source.drive, here)
    alone = SampledObject(actor.uid, "ACTOR", actor.uid, actor.uid, "", "", "", 0, poses, there)
    return camera_request(Sampled(name, here, (alone,)), view, source, float(frame), (SIZE_PX, SIZE_PX))


BACKGROUND = 0.22
"""Grey behind the actor, where nothing of it is seen, as display-referred sRGB."""


class ArrayReader(Protocol):
    """Reader of the arrays of an event."""

    def arrays(self, event: dict[str, Any]) -> dict[str, NDArray[Any]]: ...


@dataclass
class Portrait:
    """An actor that the worker renders: ``request`` is the job. Once it has ended well, ``rgba`` (H, W, 4) is the image,
    display-referred sRGB that is opaque where the actor is, and ``pixels`` (H, W, 3) the same on grey; else ``fault``
    says why not."""

    scene_path: Path
    uid: str
    request: Any
    ended: bool = False
    rgba: NDArray[np.float32] | None = None
    pixels: NDArray[np.uint8] | None = None
    fault: str = ""
    _blocks: list[NDArray[np.float32]] = field(default_factory=list)

    def take(self, worker: ArrayReader) -> None:
        """Take in what has come; returns at once."""
        while not self.ended and not self.request.events.empty():
            event = self.request.events.get()
            if event["event"] == "arrays":
                arrays = worker.arrays(event)
                number = event["instances"].index(self.uid) + 1 if self.uid in event["instances"] else -1
                shown = (arrays["instance"] == number)[..., None].astype(np.float32)
                self._blocks.append(np.concatenate([np.clip(arrays["rgb"], 0, 1), shown], -1))
            elif event["event"] not in ("warning", "progress"):
                self.ended, self.fault = True, event.get("text", "")
                if event["event"] == "done" and self._blocks:
                    self.rgba = np.concatenate(self._blocks)
                    on_grey = np.where(self.rgba[..., 3:] > 0, self.rgba[..., :3], BACKGROUND)
                    self.pixels = np.asarray(255 * on_grey + 0.5, np.uint8)


def portrait_path(scene_path: Path, uid: str) -> Path:
    """Return where an actor's rendered thumbnail is kept: elsewhere once the scene has changed."""
    try:
        changed = (scene_path / HEADER_NAME).stat().st_mtime_ns
    except OSError:
        changed = 0
    key = hashlib.sha256(json.dumps([str(scene_path.resolve()), changed]).encode()).hexdigest()[:32]
    return cache_folder() / "actors" / key / f"{hashlib.sha256(uid.encode()).hexdigest()[:16]}.png"


def saved_portrait(scene_path: Path, uid: str) -> Path | None:
    """Return an actor's rendered thumbnail; None where it has not been made."""
    path = portrait_path(scene_path, uid)
    return path if path.is_file() else None


def save_portrait(scene_path: Path, uid: str, pixels: NDArray[np.uint8]) -> Path:
    """Keep an actor's rendered thumbnail (H, W, 3), and return its file. Raises `OutputError`."""
    path = portrait_path(scene_path, uid)
    write_file(path, png(pixels))
    return path
