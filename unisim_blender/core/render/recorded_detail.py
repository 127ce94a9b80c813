"""Detail of recorded images that a trained scene lacks: the differences of recorded images from renders of them, warped to
another image where both show the same surface.

A field blurs what its cells and steps do not resolve, most of all nearby. The image that shows it was recorded: image-based
rendering adds it (Debevec et al., "Efficient view-dependent image-based rendering with projective texture-mapping", 1998).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..data.images import resize_image
from ..data.log import Log
from ..data.own_vehicle import outlines_from_json, shows_scene
from ..errors import LogError
from ..geometry import BoolArray, FloatArray, bilinear, invert_pose
from ..sensors.camera import line_times, pixel_grid
from ..sensors.frames import CameraFrame
from ..sensors.rays import exposure_window
from ..world.classes import motion_of
from ..world.drive import Actor, Camera, Drive
from ..world.replay import DriveStates, WorldState
from .confidence import TURN_M
from .pending_image import Binding, PendingImage
from .tracer import Array, Backend

REFERENCES, MAX_PIXELS = 4, 2**24
"""Number of recorded images that an image gets detail of, and largest number of pixels of all that stay in memory, of 12 bytes
each."""
PART = 0.6
"""Part of a difference that is added: poses and distances are not exact, so some of it would land beside its place."""
ANGLE_RAD = 0.35
"""Angle between the rays of both images over which the part falls by a factor e."""
TOLERANCE, TOLERANCE_M = 0.03, 0.05
"""Difference of distances of one surface: a part of the distance, and metres."""
FAR_M = 150.0
"""Distance, metres, from which on surfaces of the scene mean little."""


class PlainRenderer(Protocol):
    """A renderer that adds nothing to what its backend's scene has."""

    backend: Backend

    def render(self, state: WorldState, sensor: Camera, time_s: float, passes: Sequence[str]) -> CameraFrame:
        """See `Renderer.render`."""
        ...


@dataclass(frozen=True)
class DetailView:
    """A recorded image: what its render lacks (h, w, 3), exposed as for a gain of 1, the render's ``depth_m`` (h, w), metres,
    and ``actor`` (h, w): rows of the drive's actors, 0 for none, -1 where the image shows the recording vehicle."""

    camera: Camera
    time_s: float
    detail: NDArray[np.float16]
    depth_m: Array
    actor: NDArray[np.int16]
    poses: FloatArray
    """Poses (h, 4, 4) of the rows, world_from_camera."""

    def project(self, points: FloatArray) -> tuple[NDArray[np.int64], FloatArray, FloatArray, FloatArray]:
        """Return the numbers (M,) of those places (N, 3), world frame, that are inside the image, their image points u, v (M,),
        pixels, and their distances (M,), metres."""
        middle = self.poses[len(self.poses) // 2]
        _, v, inside = self._on_image(np.einsum("ji,nj->ni", middle[:3, :3], points - middle[:3, 3]))
        some = np.flatnonzero(inside)
        rows = v[some].astype(np.int64)
        away = points[some] - self.poses[rows, :3, 3]
        u, v, inside = self._on_image(np.einsum("nji,nj->ni", self.poses[rows, :3, :3], away))
        return some[inside], u[inside], v[inside], np.linalg.norm(away[inside], axis=1)

    def _on_image(self, local: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        model = self.camera.model
        u, v, valid = model.project(local)
        return u, v, valid & (u >= 0) & (u < model.width) & (v >= 0) & (v < model.height)


def training_images(drive: Drive, training: Mapping[str, Any], log: Log) -> list[tuple[str, int, float]]:
    """Return camera, frame and time of the images of a log that a scene was trained on. ``drive`` is that of the scene, and
    ``training`` what its header tells of its training. Raises `LogError` where the log has none of them."""
    frames = set(training.get("frames", ()))
    shots = [
        (name, frame, drive.cameras[name].time_s[frame])
        for name in training.get("cameras", ())
        if name in drive.cameras and name in log.drive.cameras
        for frame in sorted(frames & set(drive.cameras[name].time_s) & set(log.image_frames(name)))
    ]
    if not shots:
        raise LogError(f"{log.path}: has none of the images that the scene was trained on; detail is made of these")
    return shots


class RecordedDetail:
    """The detail of the images of a log that a scene was trained on, which are rendered when an image first needs them.

    See `training_images` for its arguments and errors.
    """

    def __init__(self, renderer: PlainRenderer, drive: Drive, training: Mapping[str, Any], log: Log) -> None:
        self.drive, self._log = drive, log
        self._rows = {uid: row for row, uid in enumerate(sorted(self.drive.actors), 1)}
        self._outlines = outlines_from_json(training.get("own_vehicle"))
        self._width = training.get("width")
        self._shots = training_images(drive, training, log)
        self._poses = np.array([self.drive.cameras[n].world_from_camera.at(t) for n, _, t in self._shots])
        self._states = DriveStates(self.drive, renderer.backend.parked)
        self._renderer = renderer
        self._views: dict[tuple[int, int], DetailView] = {}

    def added(
        self,
        pending: PendingImage,
        bound: Binding,
        image: Array,
        points: FloatArray,
        times_s: FloatArray,
        instance: NDArray[np.int32],
        own: Sequence[Actor | None],
    ) -> Array:
        """Return the image (H, W, 3) with the detail of the closest recorded images. Its pixels show ``points`` (H, W, 3), world
        frame, at ``times_s`` (H, W), of ``instance`` (H, W) among ``own``: the actors in the order of their numbers, None for
        those of other scenes."""
        camera, time_s = pending.camera, pending.time_s
        pose = camera.world_from_camera.at(time_s)
        flat, number = points.reshape(-1, 3), instance.reshape(-1)
        to = flat - pose[:3, 3]
        distance = np.linalg.norm(to, axis=1)
        some = np.flatnonzero(distance < FAR_M)
        flat, number, to, late_s = (
            flat[some],
            number[some],
            to[some] / distance[some, None],
            times_s.ravel()[some] - time_s,
        )
        total, weights = np.zeros((len(some), 3), np.float32), np.zeros((len(some), 1), np.float32)
        for shot in self._closest(pose):
            view = self._view(shot, camera.model.width)
            for places, rays, which, row in self._placed(view, flat, to, number, own, time_s, late_s):
                inside, u, v, away = view.project(places)
                cell = v.astype(np.int64), u.astype(np.int64)
                alike = np.abs(view.depth_m[cell] - away) < TOLERANCE * away + TOLERANCE_M
                alike &= view.actor[cell] == row
                if not alike.any():
                    continue
                shown = inside[alike]
                back = places[shown] - view.poses[len(view.poses) // 2, :3, 3]
                cosine = (back * rays[shown]).sum(1) / np.maximum(np.linalg.norm(back, axis=1), 1e-6)
                weight = np.exp(-np.arccos(np.clip(cosine, -1, 1)) / ANGLE_RAD).astype(np.float32)[:, None]
                total[which[shown]] += weight * bilinear(view.detail, u[alike], v[alike])
                weights[which[shown]] += weight
        gain = bound.gain(camera.sensor_id, time_s)
        added = PART * total / np.maximum(weights, 1)
        out = image.copy()
        out.reshape(-1, 3)[some] += added if gain is None else added * gain
        return np.clip(out, 0, 1)

    def _closest(self, pose: FloatArray) -> list[int]:
        """Return the numbers of the recorded images that are closest to a pose."""
        away = np.linalg.norm(self._poses[:, :3, 3] - pose[:3, 3], axis=1)
        turned = TURN_M * (1 - self._poses[:, :3, 2] @ pose[:3, 2])
        return np.argsort(away + turned, kind="stable")[:REFERENCES].tolist()

    def _placed(
        self,
        view: DetailView,
        points: FloatArray,
        rays: FloatArray,
        number: NDArray[np.int32],
        own: Sequence[Actor | None],
        time_s: float,
        late_s: FloatArray,
    ) -> Iterator[tuple[FloatArray, FloatArray, NDArray[np.int64], int]]:
        """Yield where points and unit rays to them were as a view was taken (M, 3), their numbers (M,) and their actor's
        row."""
        static = np.flatnonzero(number == 0)
        yield points[static], rays[static], static, 0
        for index, actor in enumerate(own, 1):
            recorded = None if actor is None else self.drive.actors.get(actor.appearance.actor)
            which = np.flatnonzero(number == index)
            if actor is None or recorded is None or actor.is_scaled or not len(which):
                continue
            # limbs move from image to image
            if motion_of(recorded.label) == "deforming" or not recorded.present(view.time_s):
                continue
            # rows are exposed one after the other, in the recorded image about as late as in this
            moments, row = np.unique(late_s[which], return_inverse=True)
            moved = recorded.world_from_actor.at(view.time_s + moments) @ invert_pose(
                actor.world_from_actor.at(time_s + moments)
            )
            turn = moved[row, :3, :3]
            places = np.einsum("nij,nj->ni", turn, points[which]) + moved[row, :3, 3]
            yield places, np.einsum("nij,nj->ni", turn, rays[which]), which, self._rows[recorded.uid]

    def _view(self, shot: int, width: int) -> DetailView:
        """Return a recorded image's detail for an image of a width, pixels; it stays in memory for a while."""
        name, frame, time_s = self._shots[shot]
        camera = self.drive.cameras[name]
        # images larger than those of the training take what was recorded
        if self._width and width <= self._width:
            camera = camera.resized(self._width)
        key = shot, camera.model.width
        view = self._views.pop(key, None) or self._rendered(camera, name, frame, time_s)
        self._views[key] = view
        while len(self._views) > REFERENCES and sum(each.depth_m.size for each in self._views.values()) > MAX_PIXELS:
            del self._views[next(iter(self._views))]
        return view

    def _rendered(self, camera: Camera, name: str, frame: int, time_s: float) -> DetailView:
        """Return the detail of a camera's recorded image, at that camera's size."""
        state = self._states.state(*exposure_window(camera, time_s))
        rendered = self._renderer.render(state, camera, time_s, ("rgb", "depth", "instance"))
        assert rendered.depth_m is not None and rendered.instance is not None
        image = resize_image(self._log.image(name, frame), camera.model).astype(np.float32) / 255
        gain = Binding(self._renderer.backend).gain(name, time_s)
        detail = (image - rendered.rgb) / (1 if gain is None else gain)
        table = np.array([0, *(self._rows.get(uid, -1) for uid in rendered.instances)], np.int16)
        actor = table[rendered.instance]
        outline = self._outlines.get(name)
        if outline is not None:
            model = camera.model
            scene = shows_scene(*outline, *pixel_grid(model), (model.width, model.height))
            actor = np.where(scene, actor, np.int16(-1))
        v = np.arange(camera.model.height) + 0.5
        poses = camera.world_from_camera.at(line_times(camera, time_s, v))
        return DetailView(camera, time_s, detail.astype(np.float16), rendered.depth_m, actor, poses)
