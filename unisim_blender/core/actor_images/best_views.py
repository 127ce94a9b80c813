"""The recorded images in which each actor of a drive is seen best: large, inside the image, with no other actor before
it; and the actor cut out of one, as a square thumbnail in which what is not the actor is dimmed."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..data.own_vehicle import Outline, shows_scene
from ..geometry import BoolArray, FloatArray, box_corners, invert_pose, transform_points
from ..sensors.silhouettes import box_silhouette
from ..world.drive import Actor, Camera, CameraModel, Drive

Outlines = Mapping[str, tuple[Outline, int]]
"""The recording vehicle's outline in the images of each camera that shows it, with the height of these images."""

NEAREST_M = 0.5
"""Smallest depth, metres, of a box's corners in a view: a nearer box is cut by the image, or beside a wide lens."""
ENOUGH_PX = 40000.0
"""Area in the image, pixels, above which a view does not improve."""
CANDIDATES = 40
"""Number of views of an actor whose occlusion is computed."""
APART = 4
"""Smallest number of frames between two views of an actor by one camera."""
LATTICE = 10
"""Number of samples of occlusion along each edge of an actor's rectangle."""


@dataclass(frozen=True)
class ActorView:
    """An actor in one image.

    ``rectangle`` (4,) is left, top, right, bottom of the projected box in pixels, cut at the image's edges; ``pose``
    (4, 4) is world_from_actor and ``camera_pose`` (4, 4) world_from_camera at the image's time. ``visible`` is the
    fraction of the rectangle that no nearer actor's rectangle covers, ``inside`` that of the uncut rectangle that the
    image has, and ``clear`` that of the LiDAR returns in the rectangle which nothing before the actor gave. ``nearer``
    (N, 4) are the rectangles of nearer actors; ``outline`` is that of the recording vehicle's body in the camera's
    images, with their height, where it is in them: what lies below it is covered too.
    """

    camera: str
    frame: int
    rectangle: FloatArray
    pose: FloatArray
    camera_pose: FloatArray
    visible: float
    inside: float
    nearer: FloatArray
    clear: float = 1.0
    outline: tuple[Outline, int] | None = None

    def free(self, u: FloatArray, v: FloatArray, model: CameraModel) -> BoolArray:
        """Return which points u, v (...) of the image neither a nearer actor's rectangle nor the
        recording vehicle covers."""
        free = np.ones(np.shape(u), bool)
        for left, top, right, bottom in self.nearer:
            free &= ~((u >= left) & (u <= right) & (v >= top) & (v <= bottom))
        if self.outline is not None:
            free &= shows_scene(*self.outline, u, v, (model.width, model.height))
        return free

    @property
    def area_px(self) -> float:
        """Area of the rectangle in pixels."""
        left, top, right, bottom = self.rectangle
        return float((right - left) * (bottom - top))

    @property
    def score(self) -> float:
        """Quality of the view; larger is better."""
        return float(np.sqrt(min(self.area_px, ENOUGH_PX)) * (self.visible * self.clear) ** 3 * self.inside**2)


@dataclass(frozen=True)
class ActorsInImages:
    """All actors in the images of one camera: rectangles (A, F, 4) uncut and cut, depths (A, F),
    whether there (A, F)."""

    camera: Camera
    frames: tuple[int, ...]
    camera_poses: FloatArray
    full: FloatArray
    cut: FloatArray
    depth_m: FloatArray
    there: BoolArray


def best_views(
    drive: Drive, image_frames: Mapping[str, Sequence[int]], most: int = 3, outlines: Outlines | None = None
) -> dict[str, list[ActorView]]:
    """Return up to ``most`` views of each actor by id, the best first; an actor that no image shows has none.

    ``image_frames`` names the frames of which each camera has an image.
    """
    actors = list(drive.actors.values())
    seen = [
        actors_in_images(actors, camera, tuple(frame for frame in image_frames.get(name, ()) if frame in camera.time_s))
        for name, camera in drive.cameras.items()
    ]
    seen = [camera_views for camera_views in seen if camera_views.frames]
    return {
        actor.uid: _spread(_views(actor, number, seen, outlines or {}), most) for number, actor in enumerate(actors)
    }


def _spread(views: list[ActorView], most: int) -> list[ActorView]:
    """Return the first views that are not neighbours: adjacent frames show the same."""
    chosen: list[ActorView] = []
    for view in views:
        if len(chosen) < most and all(
            other.camera != view.camera or abs(other.frame - view.frame) >= APART for other in chosen
        ):
            chosen.append(view)
    return chosen


def actors_in_images(actors: list[Actor], camera: Camera, frames: tuple[int, ...]) -> ActorsInImages:
    """Return where a camera's images of some frames show the boxes of actors."""
    times = np.array([camera.time_s[frame] for frame in frames])
    count, model = len(frames), camera.model
    poses = camera.world_from_camera.at(times)
    full, depth = np.zeros((len(actors), count, 4)), np.full((len(actors), count), np.inf)
    there = np.zeros((len(actors), count), bool)
    if count:
        from_world = invert_pose(poses)
        for number, actor in enumerate(actors):
            corners = transform_points(actor.world_from_actor.at(times), box_corners(np.eye(4), actor.size_m))
            x, y, z = np.moveaxis(transform_points(from_world, corners), -1, 0)
            ahead = z.min(-1) > NEAREST_M
            safe = np.where(ahead[:, None], z, 1.0)
            if model.is_pinhole:
                u, v = model.fx * x / safe + model.cx, model.fy * y / safe + model.cy
                full[number] = np.stack([u.min(-1), v.min(-1), u.max(-1), v.max(-1)], -1)
            else:
                camera_from_actor = from_world @ actor.world_from_actor.at(times)
                rectangles = [
                    box_silhouette(model, pose, actor.size_m) if there else None
                    for pose, there in zip(camera_from_actor, ahead, strict=True)
                ]
                full[number] = [rectangle or (0.0, 0.0, 0.0, 0.0) for rectangle in rectangles]
            depth[number] = z.mean(-1)
            there[number] = ahead & actor.present(times)
    cut = np.clip(full, 0.0, [model.width, model.height, model.width, model.height])
    there &= (cut[..., 2] - cut[..., 0] > 2) & (cut[..., 3] - cut[..., 1] > 2)
    return ActorsInImages(camera, frames, poses, full, cut, depth, there)


def _area(rectangles: FloatArray) -> FloatArray:
    return np.asarray((rectangles[..., 2] - rectangles[..., 0]) * (rectangles[..., 3] - rectangles[..., 1]))


def _views(actor: Actor, number: int, seen: list[ActorsInImages], outlines: Outlines) -> list[ActorView]:
    """Return the views of one actor, best first."""
    ranked = []
    for at, in_camera in enumerate(seen):
        for i in np.flatnonzero(in_camera.there[number]):
            cut, full = _area(in_camera.cut[number, i]), _area(in_camera.full[number, i])
            inside = float(cut / full)
            ranked.append((float(np.sqrt(min(float(cut), ENOUGH_PX)) * inside**2), float(cut), at, int(i), inside))
    ranked.sort(reverse=True)
    views = []
    for _, _, at, i, inside in ranked[:CANDIDATES]:
        in_camera = seen[at]
        others = in_camera.there[:, i] & (in_camera.depth_m[:, i] < in_camera.depth_m[number, i] - 0.1)
        nearer = in_camera.cut[others, i]
        frame = in_camera.frames[i]
        pose = actor.world_from_actor.at(in_camera.camera.time_s[frame])
        view = ActorView(
            in_camera.camera.sensor_id, frame, in_camera.cut[number, i], pose, in_camera.camera_poses[i], 1.0, inside, nearer,
            outline=outlines.get(in_camera.camera.sensor_id),
        )  # fmt: skip
        views.append(replace(view, visible=_visible(view, in_camera.camera.model)))
    return sorted(views, key=lambda view: -view.score)


def _visible(view: ActorView, model: CameraModel) -> float:
    """Fraction of a view's rectangle that nothing known covers."""
    steps = (np.arange(LATTICE) + 0.5) / LATTICE
    left, top, right, bottom = view.rectangle
    u, v = np.meshgrid(left + steps * (right - left), top + steps * (bottom - top))
    return float(view.free(u, v, model).mean())


SIZE_PX = 192
MARGIN = 1.25
"""Edge of the square beside the longer edge of the actor's rectangle."""
DIMMED = 0.55
"""Brightness of what lies outside the actor's rectangle."""
LEAST_PX = 24
"""Smallest square, pixels: a smaller one would show blocks and no surroundings."""


def crop(image: NDArray[np.uint8], view: ActorView) -> NDArray[np.uint8]:
    """Return a square (`SIZE_PX`, `SIZE_PX`, 3) of an image (H, W, 3) around an actor, kept inside the
    image where it fits."""
    from PIL import Image

    height, width = image.shape[:2]
    left, top, right, bottom = view.rectangle
    edge = min(max(MARGIN * max(right - left, bottom - top), LEAST_PX), width, height)
    x = float(np.clip((left + right - edge) / 2, 0, width - edge))
    y = float(np.clip((top + bottom - edge) / 2, 0, height - edge))
    part = Image.fromarray(image).resize((SIZE_PX, SIZE_PX), Image.Resampling.BICUBIC, box=(x, y, x + edge, y + edge))
    pixels = np.asarray(part, np.float32)
    u, v = (x + (np.arange(SIZE_PX) + 0.5) * edge / SIZE_PX, y + (np.arange(SIZE_PX) + 0.5) * edge / SIZE_PX)
    room = 0.03 * edge
    inside = ((v >= top - room) & (v <= bottom + room))[:, None] & ((u >= left - room) & (u <= right + room))
    return np.asarray(np.where(inside[..., None], pixels, pixels * DIMMED), np.uint8)


def png(pixels: NDArray[np.uint8]) -> bytes:
    """Return an image (H, W, 3) or (H, W, 4) as a PNG file."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return buffer.getvalue()
