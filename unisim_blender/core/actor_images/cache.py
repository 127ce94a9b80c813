"""Thumbnails and words for the colours of a log's actors, computed once and cached in the user's cache folder.

Views of an actor in which a fence or a wall stands before it are left out, as LiDAR returns between it and the camera tell.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..data.log import Log
from ..data.own_vehicle import Outline, find_outline, given_outline, joined, moved_frames
from ..errors import UnisimError
from ..files import cache_folder, file_stamp, write_file
from ..geometry import FloatArray, invert_pose, transform_points
from ..sensors.unprojection import image_mask
from ..world.drive import Actor, CameraModel
from .best_views import ActorView, best_views, crop, png
from .paint import Tone, paint_tone, painted_as, telling, word_of

LEAST = 6
"""Smallest number of returns around an actor from which its occlusion is judged."""
BEFORE_M = 0.4
"""Distance, metres, by which a return before the actor is nearer to the camera than the box's nearest corner."""
ABOUT_M = 0.2
"""Margin around the box, metres, within which returns are still the actor's."""
APART = 2
"""Largest distance, in frames, of a sweep that stands in for a missing one."""


def clear_fraction(points: FloatArray, size_m: FloatArray, view: ActorView, model: CameraModel) -> float:
    """Return the fraction of returns (N, 3), world, in an actor's rectangle that are its own and not of
    something before it."""
    seen = transform_points(invert_pose(view.camera_pose), points)
    ahead = seen[:, 2] > 0.5
    points, seen = points[ahead], seen[ahead]
    # NaN is within no rectangle
    u, v, _ = model.project(seen)
    left, top, right, bottom = view.rectangle
    within = (u > left) & (u < right) & (v > top) & (v < bottom)
    within &= view.free(u, v, model)
    points, depth = points[within], seen[within, 2]
    local = transform_points(invert_pose(view.pose), points)
    half = np.asarray(size_m, float) / 2
    own = (np.abs(local) <= half + ABOUT_M).all(-1)
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), -1).reshape(8, 3)
    corners = transform_points(invert_pose(view.camera_pose) @ view.pose, signs * half)
    before = ~own & (depth < corners[:, 2].min() - BEFORE_M)
    count = int(own.sum() + before.sum())
    return 1.0 if count < LEAST else float(own.sum() / count)


def cleared(log: Log, actors: Mapping[str, Actor], views: Mapping[str, list[ActorView]]) -> dict[str, list[ActorView]]:
    """Return the views of actors with what LiDAR says stands before them, the best first. Every sweep is read once."""
    lidar = next(iter(log.drive.lidars), "")
    frames = np.array(log.sweep_frames(lidar) if lidar else (), int)
    wanted: dict[int, list[tuple[str, int]]] = {}
    for uid, some in views.items():
        for number, view in enumerate(some):
            if len(frames):
                nearest = int(frames[np.abs(frames - view.frame).argmin()])
                if abs(nearest - view.frame) <= APART:
                    wanted.setdefault(nearest, []).append((uid, number))
    ranked = {uid: list(some) for uid, some in views.items()}
    for frame, those in sorted(wanted.items()):
        try:
            points = log.sweep(lidar, frame).points
        except (UnisimError, OSError):
            continue
        for uid, number in those:
            view = ranked[uid][number]
            clear = clear_fraction(points, actors[uid].size_m, view, log.drive.cameras[view.camera].model)
            ranked[uid][number] = replace(view, clear=clear)
    return {uid: sorted(some, key=lambda view: -view.score) for uid, some in ranked.items()}


VERSION = 1
"""Version of the cache, raised when the same log gives other content."""
INDEX = "actors.json"
LOOKED_AT = 6
"""Number of views of an actor that are checked for occlusion by LiDAR."""
OUTLINE_IMAGES = 10
"""Approximate number of images of each camera in which the recording vehicle's outline is sought."""
TELLING = 3
"""Largest number of images from which a colour is determined."""


@dataclass(frozen=True)
class ActorImage:
    """Image of one actor: the word for its colour or "", and its thumbnail's file or None where no image shows it."""

    uid: str
    word: str
    image: Path | None


def image_folder(log_path: Path) -> Path:
    """Return the folder of a log's thumbnails, which depends on the log's path and its files' state."""
    files = sorted(path for path in log_path.rglob("*") if path.is_file()) if log_path.is_dir() else [log_path]
    stamps = [(str(path), *file_stamp(path)) for path in files if path.is_file()]
    text = json.dumps([VERSION, str(log_path.resolve()), stamps])
    return cache_folder() / "actors" / hashlib.sha256(text.encode()).hexdigest()[:32]


def cached_images(log_path: Path) -> dict[str, ActorImage] | None:
    """Return the cached images of a log's actors by id; None where they are missing or incomplete."""
    folder = image_folder(log_path)
    try:
        document = json.loads((folder / INDEX).read_text())
        entries = {uid: _cached_image(uid, entry, folder) for uid, entry in document["actors"].items()}
        return entries if all(entry.image is None or entry.image.is_file() for entry in entries.values()) else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _cached_image(uid: str, entry: dict[str, str], folder: Path) -> ActorImage:
    """Return an entry of the index. Raises ValueError, KeyError or TypeError for what `make_images` does not write."""
    word, name = entry["word"], entry["image"]
    if not isinstance(word, str) or (name and Path(name).name != name):
        raise ValueError(f"{uid}: is no image of this folder")
    return ActorImage(uid, word, folder / name if name else None)


def make_images(log: Log) -> Iterator[ActorImage]:
    """Make the thumbnails and words of a log's actors, each given as soon as it is there, and keep them at the end.

    Every image and every sweep is read once. Raises `OutputError` where the cache folder cannot be written.
    """
    folder, actors = image_folder(log.path), log.drive.actors
    frames = {name: log.image_frames(name) for name in log.drive.cameras}
    views = cleared(log, actors, best_views(log.drive, frames, LOOKED_AT, _outlines(log)))
    images: dict[str, ActorImage] = {}
    for image in _from_images(log, actors, views, folder):
        images[image.uid] = image
        yield image
    for uid in sorted(set(actors) - set(images)):
        images[uid] = ActorImage(uid, "", None)
        yield images[uid]
    entries = {
        uid: {"word": image.word, "image": image.image.name if image.image else ""}
        for uid, image in sorted(images.items())
    }
    document = {"format": "unisim-actor-images", "version": VERSION, "log": str(log.path.resolve()), "actors": entries}
    write_file(folder / INDEX, json.dumps(document, indent=1).encode())


def _outlines(log: Log) -> dict[str, tuple[Outline, int]]:
    """Return the recording vehicle's outline in each camera's images, where it is in them; they are read at a quarter
    of their size."""
    outlines = {}
    for name in log.drive.cameras:
        moved = moved_frames(log.drive, log.image_frames(name))
        some = moved[:: max(1, len(moved) // OUTLINE_IMAGES)]
        try:
            images = [log.image(name, frame)[::2, ::2] for frame in some]
        except (UnisimError, OSError):
            continue
        model = log.drive.cameras[name].model
        small = replace(model, width=-(-model.width // 2), height=-(-model.height // 2))
        shown = image_mask(model)
        estimated = find_outline(images, None if shown is None else shown[::2, ::2])
        outline = joined(estimated, given_outline(log, name, small))
        if outline is not None:
            outlines[name] = outline, small.height
    return outlines


def _from_images(
    log: Log, actors: dict[str, Actor], views: dict[str, list[ActorView]], folder: Path
) -> Iterator[ActorImage]:
    """Go through the images once; an actor is finished with the last image that it needs."""
    numbers = {uid: number for number, uid in enumerate(sorted(actors))}
    asked: dict[tuple[int, str], list[tuple[str, int]]] = {}
    left: dict[str, int] = {}
    for uid, some in views.items():
        wanted = some[:1] if not painted_as(actors[uid].label) else (telling(some)[:TELLING] or some[:1])
        left[uid] = len(wanted)
        for number, view in enumerate(wanted):
            asked.setdefault((view.frame, view.camera), []).append((uid, number))
    tones: dict[str, list[tuple[Tone | None, float]]] = {uid: [] for uid in views}
    images: dict[str, Path] = {}
    for (frame, camera), those in sorted(asked.items()):
        try:
            image = log.image(camera, frame)
        except (UnisimError, OSError):
            image = None
        for uid, number in those:
            view, actor = views[uid][number], actors[uid]
            if image is not None:
                model = log.drive.cameras[camera].model
                if number == 0:
                    images[uid] = folder / f"{numbers[uid]}.png"
                    write_file(images[uid], png(crop(image, view)))
                if view in telling(views[uid]):
                    tones[uid].append((paint_tone(image, model, actor.label, actor.size_m, view), view.score))
            left[uid] -= 1
            if left[uid] == 0:
                yield ActorImage(uid, word_of(tones[uid]), images.get(uid))


def tell(log: Log) -> None:
    """Make a log's thumbnails and words, and write a line of JSON for each actor to standard output."""
    for actor_image in make_images(log):
        line = {
            "uid": actor_image.uid,
            "word": actor_image.word,
            "image": str(actor_image.image) if actor_image.image else "",
        }
        sys.stdout.write(json.dumps(line) + "\n")
        sys.stdout.flush()
