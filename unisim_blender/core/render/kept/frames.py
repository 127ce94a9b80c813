"""Frames of sensors that stand: what cannot differ from a sensor's last frame is kept, the rest is rendered.

The frames have the bits of `Renderer.render`. A camera's pose must be that of its last image, to the bit, while each is
exposed, and a LiDAR's rays those of its last sweep.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...sensors.exposure import exposure_window
from ...sensors.frames import CameraFrame, LidarFrame, RenderStats
from ...sensors.lidar import lidar_rays
from ...sensors.rays import Rays
from ...world.drive import Camera, Lidar
from ...world.state import WorldState
from ..renderer import Renderer
from ..sweeps import BeamMeasurements, sweep_frame
from .beams import dirty_beams
from .changes import changed_actors, standing_pose, static_digest
from .regions import dirty_regions

PASSES = ("rgb", "depth_m", "z_depth_m", "normal", "instance", "opacity", "unsupported")
MOST = 0.7
"""Where more of a frame may differ, all of it is rendered."""


@dataclass(frozen=True)
class _Last:
    """A sensor's last frame, and what it depends on: ``about`` is all but the actors."""

    state: WorldState
    time_s: float
    about: tuple[Any, ...]
    margin: int
    frame: CameraFrame | LidarFrame


@dataclass
class KeptFrames:
    """Renders frames and keeps the last one of each sensor that stands. A frame's ``stats`` count what was rendered for it."""

    _last: dict[str, _Last] = field(default_factory=dict)

    def image(
        self, renderer: Renderer, state: WorldState, camera: Camera, time_s: float, passes: Sequence[str]
    ) -> CameraFrame:
        """Return what `Renderer.render` does."""
        pose = standing_pose(camera.world_from_camera, *exposure_window(camera, time_s))
        if pose is None:
            self._last.pop(camera.sensor_id, None)
            return renderer.render(state, camera, time_s, passes)
        about = *_about(renderer, state, camera), pose, tuple(passes), camera.model, camera.full_width
        margin = renderer.margin(state)
        last = self._usable(renderer, camera, time_s, about, margin)
        frame = None
        if last is not None and isinstance(last.frame, CameraFrame):
            frame = _image(renderer, state, camera, time_s, passes, last, last.frame)
        if frame is None:
            frame = renderer.render(state, camera, time_s, passes)
        self._last[camera.sensor_id] = _Last(state, time_s, about, margin, frame)
        return frame

    def sweep(
        self, renderer: Renderer, state: WorldState, lidar: Lidar, time_s: float, seed: Sequence[int] | None
    ) -> LidarFrame:
        """Return what `Renderer.render` does."""
        pose = standing_pose(lidar.world_from_lidar, *exposure_window(lidar, time_s))
        if pose is None:
            self._last.pop(lidar.sensor_id, None)
            return renderer.render(state, lidar, time_s, seed=seed)
        about = *_about(renderer, state, lidar), pose
        last = self._usable(renderer, lidar, time_s, about, 0)
        frame = None
        if last is not None and isinstance(last.frame, LidarFrame):
            frame = _sweep(renderer, state, lidar, time_s, seed, last, last.frame)
        if frame is None:
            frame = renderer.render(state, lidar, time_s, seed=seed)
        self._last[lidar.sensor_id] = _Last(state, time_s, about, 0, frame)
        return frame

    def _usable(
        self, renderer: Renderer, sensor: Camera | Lidar, time_s: float, about: tuple[Any, ...], margin: int
    ) -> _Last | None:
        """Return the sensor's last frame, if a part of it can be kept."""
        last = self._last.get(sensor.sensor_id)
        if last is None or last.about != about or last.margin != margin or renderer.backend.sees_all:
            return None
        windows = [*exposure_window(sensor, last.time_s), *exposure_window(sensor, time_s)]
        return last if renderer.is_steady(sensor.sensor_id, min(windows), max(windows)) else None


def _about(renderer: Renderer, state: WorldState, sensor: Camera | Lidar) -> tuple[Any, ...]:
    """Return what a frame depends on beside the sensor's pose and the actors."""
    return renderer, renderer.quality, renderer.shadows, static_digest(state), sensor.sees_ego_body


def _image(
    renderer: Renderer, state: WorldState, camera: Camera, time_s: float, passes: Sequence[str], last: _Last,
    before: CameraFrame,
) -> CameraFrame | None:  # fmt: skip
    """Return an image of which parts are kept; None where that would save too little."""
    changed = changed_actors(last.state, state, camera)
    regions = dirty_regions(
        changed, state, camera, before.world_from_camera, renderer.reach, last.margin, renderer.backend.overhang_m
    )
    if sum(region.area for region in regions) > MOST * camera.model.width * camera.model.height:
        return None
    frame = replace(before, model=camera.model_at(time_s), stats=RenderStats())
    frame.instances = renderer.tracer(state).active.uids
    kept = {name: values for name in PASSES if (values := getattr(before, name)) is not None}
    if "instance" in kept:
        kept["instance"] = _renumbered(kept["instance"], before.instances, frame.instances)
    if regions:
        kept = {name: values.copy() for name, values in kept.items()}
    for region in regions:
        part = renderer.render(state, camera, time_s, passes, region)
        for name, values in kept.items():
            values[region.top : region.bottom, region.left : region.right] = getattr(part, name)
        frame.stats.add(part.stats)
    for name, values in kept.items():
        setattr(frame, name, values)
    return frame


def _sweep(
    renderer: Renderer, state: WorldState, lidar: Lidar, time_s: float, seed: Sequence[int] | None, last: _Last,
    before: LidarFrame,
) -> LidarFrame | None:  # fmt: skip
    """Return a sweep of which beams are kept; None where the LiDAR does not stand, or that would save too little."""
    rays = lidar_rays(lidar, time_s)
    if not np.array_equal(rays.directions, before.directions) or not np.array_equal(rays.origins, before.origins):
        return None
    changed = changed_actors(last.state, state, lidar)
    dirty = dirty_beams(changed, rays, renderer.reach, renderer.backend.overhang_m)
    if dirty.mean() > MOST:
        return None
    uids = renderer.tracer(state).active.uids
    instance = _renumbered(before.instance, before.instances, uids)
    measured = BeamMeasurements(before.depth_m, before.intensity, before.return_probability, instance)
    stats = RenderStats()
    if dirty.any():
        some = Rays(rays.origins[dirty], rays.directions[dirty], rays.time_s[dirty])
        depth, intensity, probability = before.depth_m.copy(), before.intensity.copy(), before.return_probability.copy()
        instance = instance.copy()
        depth[dirty], intensity[dirty], probability[dirty], instance[dirty] = renderer.beams(state, some, lidar, stats)
        measured = BeamMeasurements(depth, intensity, probability, instance)
    return sweep_frame(lidar, time_s, rays, measured, uids, seed, stats)


def _renumbered(instance: NDArray[np.int32], before: tuple[str, ...], after: tuple[str, ...]) -> NDArray[np.int32]:
    """Return instances numbered as ``after`` names them; those that are not there have none."""
    if before == after:
        return instance
    numbers = {uid: number for number, uid in enumerate(after, 1)}
    return np.array([0, *(numbers.get(uid, 0) for uid in before)], np.int32)[instance]
