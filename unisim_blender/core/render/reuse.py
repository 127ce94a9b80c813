"""Frames of sensors that stand: pixels and beams that cannot differ from a sensor's last frame are reused, the rest is
rendered.

The frames have the bits of `Renderer.render`. A camera's pose must be that of its last image, to the bit, while each is
exposed, and a LiDAR's rays those of its last sweep.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..sensors.frames import CameraFrame, LidarFrame, RenderStats
from ..sensors.lidar import BeamMeasurements, beam_times, same_directions, sweep_frame
from ..sensors.rays import Rays, exposure_window
from ..world.drive import Camera, Lidar
from ..world.replay import WorldState
from .changes import RenderedState, changed_beams, changed_regions, standing_pose
from .renderer import Renderer

MAX_CHANGED_SHARE = 0.7
"""Share of a frame that may differ above which all of it is rendered."""


@dataclass(frozen=True)
class _LastFrame:
    rendered: RenderedState
    time_s: float
    frame: CameraFrame | LidarFrame


@dataclass
class FrameReuse:
    """Renders frames, and reuses the last one of each sensor that stands. A frame's ``stats`` count what was rendered
    for it."""

    _last: dict[str, _LastFrame] = field(default_factory=dict)

    def may_reuse(self, sensor: Camera | Lidar, time_s: float) -> bool:
        """Return whether a sensor stands in a frame's exposure, so that `image` or `sweep` may reuse its last frame."""
        return standing_pose(sensor.trajectory, *exposure_window(sensor, time_s)) is not None

    def image(
        self, renderer: Renderer, state: WorldState, camera: Camera, time_s: float, passes: Sequence[str]
    ) -> CameraFrame:
        pose = standing_pose(camera.world_from_camera, *exposure_window(camera, time_s))
        if pose is None:
            self._last.pop(camera.sensor_id, None)
            return renderer.render(state, camera, time_s, passes)
        about = *_about(renderer, camera), pose, tuple(passes), camera.model, camera.full_width
        rendered = RenderedState(state, about, renderer.margin(state))
        last = self._usable(renderer, camera, time_s)
        frame = None
        if last is not None and isinstance(last.frame, CameraFrame):
            frame = _image(renderer, rendered, camera, time_s, passes, last.rendered, last.frame)
        if frame is None:
            frame = renderer.render(state, camera, time_s, passes)
        self._last[camera.sensor_id] = _LastFrame(rendered, time_s, frame)
        return frame

    def sweep(
        self, renderer: Renderer, state: WorldState, lidar: Lidar, time_s: float, seed: Sequence[int] | None
    ) -> LidarFrame:
        pose = standing_pose(lidar.world_from_lidar, *exposure_window(lidar, time_s))
        if pose is None:
            self._last.pop(lidar.sensor_id, None)
            return renderer.render(state, lidar, time_s, seed=seed)
        # sweeps of clear air are reused, whatever the weather does
        in_weather, state = state, replace(state, weather=None)
        rendered = RenderedState(state, (*_about(renderer, lidar), pose))
        last = self._usable(renderer, lidar, time_s)
        frame = None
        if last is not None and isinstance(last.frame, LidarFrame):
            frame = _sweep(renderer, rendered, lidar, time_s, seed, last.rendered, last.frame)
        if frame is None:
            frame = renderer.render(state, lidar, time_s, seed=seed)
        self._last[lidar.sensor_id] = _LastFrame(rendered, time_s, frame)
        return renderer.sweep_in_weather(frame, in_weather, lidar, time_s)

    def _usable(self, renderer: Renderer, sensor: Camera | Lidar, time_s: float) -> _LastFrame | None:
        """Return the sensor's last frame, if what stands has the same bits in it."""
        last = self._last.get(sensor.sensor_id)
        if last is None:
            return None
        windows = [*exposure_window(sensor, last.time_s), *exposure_window(sensor, time_s)]
        return last if renderer.is_steady(sensor.sensor_id, min(windows), max(windows)) else None


def _about(renderer: Renderer, sensor: Camera | Lidar) -> tuple[object, ...]:
    """Return what a frame depends on beside its state and the sensor's pose."""
    return renderer, renderer.quality, renderer.shadows, sensor.sees_ego_body


def _image(
    renderer: Renderer, rendered: RenderedState, camera: Camera, time_s: float, passes: Sequence[str],
    last: RenderedState, before: CameraFrame,
) -> CameraFrame | None:  # fmt: skip
    """Return an image of which parts are reused; None where that would save too little."""
    regions = changed_regions(renderer, last, rendered, camera)
    area = camera.model.width * camera.model.height
    if regions is None or sum(region.area for region in regions) > MAX_CHANGED_SHARE * area:
        return None
    frame = replace(before, model=camera.model_at(time_s), stats=RenderStats())
    frame.instances = renderer.tracer(rendered.state).active.uids
    arrays = before.arrays()
    if "instance" in arrays:
        arrays["instance"] = _renumbered(arrays["instance"], before.instances, frame.instances)
    if regions:
        arrays = {name: values.copy() for name, values in arrays.items()}
    for region in regions:
        part = renderer.render(rendered.state, camera, time_s, passes, region)
        for name, values in arrays.items():
            values[region.top : region.bottom, region.left : region.right] = getattr(part, name)
        frame.stats.add(part.stats)
    for name, values in arrays.items():
        setattr(frame, name, values)
    return frame


def _sweep(
    renderer: Renderer, rendered: RenderedState, lidar: Lidar, time_s: float, seed: Sequence[int] | None,
    last: RenderedState, before: LidarFrame,
) -> LidarFrame | None:  # fmt: skip
    """Return a sweep of which beams are reused; None where the LiDAR does not stand, or that would save too little."""
    if not same_directions(lidar.model_at(time_s), before.model):
        return None
    # a GPU's rays are rounded otherwise than the host's
    rays = Rays(before.origins, before.directions, beam_times(lidar, time_s))
    changed = changed_beams(renderer, last, rendered, lidar, rays)
    if changed is None or changed.mean() > MAX_CHANGED_SHARE:
        return None
    uids = renderer.tracer(rendered.state).active.uids
    depth, intensity, probability = before.depth_m, before.intensity, before.return_probability
    instance = _renumbered(before.instance, before.instances, uids)
    stats = RenderStats()
    if changed.any():
        some = rays.part(changed)
        depth, intensity = depth.copy(), intensity.copy()
        probability, instance = probability.copy(), instance.copy()
        depth[changed], intensity[changed], probability[changed], instance[changed] = renderer.beams(
            rendered.state, some, lidar, stats
        )
    measured = BeamMeasurements(depth, intensity, probability, instance)
    return sweep_frame(lidar, time_s, rays, measured, uids, seed, stats)


def _renumbered(instance: NDArray[np.int32], before: tuple[str, ...], after: tuple[str, ...]) -> NDArray[np.int32]:
    """Return instances numbered as ``after`` names them; those that are not there have none."""
    if before == after:
        return instance
    numbers = {uid: number for number, uid in enumerate(after, 1)}
    return np.array([0, *(numbers.get(uid, 0) for uid in before)], np.int32)[instance]
