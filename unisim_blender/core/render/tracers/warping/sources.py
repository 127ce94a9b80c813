"""Which recorded images an image is warped from, and those images, read once."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ....data.log import Log
from ....geometry import FloatArray
from ....world.drive import Actor
from ....world.replay import with_windows
from ....world.state import WorldState
from ..surfels.model import SurfelScene
from ..surfels.placed import PlacedSurfels
from ..surfels.views import RecordedView, open_view

NEAREST = 2
SHIFT_FRAMES = (0, -4, 4, -8, -12)
"""UniSim's supplementary, 2.1: two images for the recorded trajectory; beside it every fourth from 12 frames
before to 4 after."""
ASIDE_M = 0.5
"""A camera at least this far from its recorded trajectory counts as beside it."""
SECOND_M = 0.5
"""A second's difference in time counts as so many metres: where the vehicle stands, what was seen last is nearest."""
FACING = 0.2
"""Cosine between a camera's axis and where rays go, from which on its images are looked at."""
DEPTH_WIDTH = 640
KEPT = 24
"""Images that are held at once."""


class SourceImage(NamedTuple):
    """A recorded image."""

    camera: str
    frame: int


class Sources:
    """A log's images of the ``frames`` that may be used, with the depths of a scene's surfels in them."""

    def __init__(self, log: Log, scene: SurfelScene, frames: Sequence[int]) -> None:
        self.log, self.drive = log, log.drive
        allowed = set(frames)
        self.frames = {name: [f for f in log.image_frames(name) if f in allowed] for name in self.drive.cameras}
        self.poses = {}
        for name, numbers in self.frames.items():
            camera = self.drive.cameras[name]
            if numbers:
                times = np.array([camera.time_s[frame] for frame in numbers])
                self.poses[name] = times, camera.world_from_camera.at(times)
        self.recorded = {actor.uid: actor for actor in with_windows(self.drive, self.drive.actors.values())}
        self.outlines, self.exposures = scene.outlines, scene.exposures
        self.surfels = PlacedSurfels(scene.static, [(actor, scene.actors[uid]) for uid, actor in self.recorded.items()])
        self._views: OrderedDict[tuple[Any, ...], RecordedView] = OrderedDict()

    def elsewhere(self, state: WorldState) -> tuple[str, ...]:
        """Return the ids of recorded actors that are not where they were recorded: in the images they hide what is
        behind their recorded boxes."""
        now = {actor.uid for actor in state.actors if self.unedited(actor, state)}
        there = (a for a in self.recorded.values() if a.start_s <= state.end_s and a.end_s >= state.start_s)
        return tuple(actor.uid for actor in there if actor.uid not in now)

    def view(self, source: SourceImage, shrink: int, elsewhere: tuple[str, ...]) -> RecordedView:
        """The image at one ``shrink``-th of its width; ``elsewhere`` as the method of that name gives it.
        Raises `LogError`."""
        key = *source, shrink, elsewhere
        if key not in self._views:
            width = max(1, self.drive.cameras[source.camera].model.width // shrink)
            depth_width = min(width, DEPTH_WIDTH)
            hiding = [self.recorded[uid] for uid in elsewhere]
            view = open_view(self.log, *source, width, depth_width, self.surfels, hiding, self.outlines)
            time_s = np.array([view.camera.time_s[source.frame]])
            self._views[key] = replace(view, gain=self.exposures.at(source.camera, time_s)[0])
            while len(self._views) > KEPT:
                self._views.popitem(last=False)
        self._views.move_to_end(key)
        return self._views[key]

    def shrink(self, camera: str, pixel_rad: float) -> int:
        """How much smaller an image may be whose pixels are to show no less than ``pixel_rad``."""
        return int(np.clip(self.drive.cameras[camera].model.pixels_per_rad * pixel_rad + 0.25, 1, 8))

    def about(self, origin: FloatArray, direction: FloatArray, time_s: float) -> list[SourceImage]:
        """The images for rays from a place (3,) in about that direction (3,) at a time, the camera
        that faces it first."""
        found: list[list[SourceImage]] = []
        for name in self._facing(direction):
            times, poses = self.poses[name]
            near = np.linalg.norm(poses[:, :3, 3] - origin, axis=1) + SECOND_M * np.abs(times - time_s)
            order = np.argsort(near, kind="stable")
            aside = poses[order[0], :3, :3].T @ (origin - poses[order[0], :3, 3])
            numbers = self.frames[name]
            chosen = [numbers[i] for i in order[:NEAREST]]
            if np.hypot(aside[0], aside[1]) > ASIDE_M:
                middle = numbers[int(order[0])]
                chosen = [min(numbers, key=lambda frame: abs(frame - (middle + k))) for k in SHIFT_FRAMES]  # noqa: B023
            found.append([SourceImage(name, frame) for frame in dict.fromkeys(chosen)])
        return [source for sources in found for source in sources]

    def farther(self, origin: FloatArray, direction: FloatArray, time_s: float) -> list[SourceImage]:
        """More images, for what those show that lies behind something there."""
        found = []
        for name in self._facing(direction)[:1]:
            times, poses = self.poses[name]
            near = np.linalg.norm(poses[:, :3, 3] - origin, axis=1) + SECOND_M * np.abs(times - time_s)
            middle = self.frames[name][int(near.argmin())]
            wanted = [middle + k for k in (-4, 4, -8, 8, -16, 16, -32, 32)]
            found += [SourceImage(name, min(self.frames[name], key=lambda frame: abs(frame - k))) for k in wanted]  # noqa: B023
        return list(dict.fromkeys(found))

    def of_actor(self, uid: str, place: FloatArray, direction: FloatArray) -> list[SourceImage]:
        """The images that show an actor as it is seen from a place (3,) in its box, in a direction
        (3,) of the world."""
        actor, found = self.recorded[uid], []
        for name in self._facing(direction):
            times, poses = self.poses[name]
            there = actor.present(times)
            inward = actor.world_from_actor.at(times)
            local = np.einsum("nji,nj->ni", inward[:, :3, :3], poses[:, :3, 3] - inward[:, :3, 3])
            ahead = np.einsum("nij,ni->nj", poses[:, :3, :3], inward[:, :3, 3] - poses[:, :3, 3])[:, 2] > 0
            near = np.where(there & ahead, np.linalg.norm(local - place, axis=1), np.inf)
            found += [
                (near[i], SourceImage(name, self.frames[name][i])) for i in np.argsort(near, kind="stable")[:NEAREST]
            ]
        return [source for distance, source in sorted(found) if np.isfinite(distance)][:NEAREST]

    def _facing(self, direction: FloatArray) -> list[str]:
        """Cameras by how well they face a direction (3,)."""
        facing = {name: float(poses[:, :3, 2].mean(0) @ direction) for name, (_, poses) in self.poses.items()}
        return [name for name in sorted(facing, key=lambda n: (-facing[n], n)) if facing[name] > FACING]

    def unedited(self, actor: Actor, state: WorldState) -> bool:
        """Whether an actor of a state goes the way that was recorded, as large as it was."""
        recorded = self.recorded.get(actor.uid)
        if recorded is None or actor.appearance.actor != actor.uid or actor.is_scaled:
            return False
        a, b = actor.world_from_actor, recorded.world_from_actor.between(state.start_s, state.end_s)
        return np.array_equal(a.times_s, b.times_s) and np.array_equal(a.positions, b.positions)
