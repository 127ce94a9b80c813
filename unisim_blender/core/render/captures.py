"""The captures of a drive: the state of the world that each depends on, and its frame by a renderer."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

from ..errors import SceneError
from ..sensors.frames import CameraFrame, LidarFrame
from ..sensors.rays import exposure_window
from ..world.captures import Capture
from ..world.drive import Camera, Drive, Lidar
from ..world.replay import DriveStates, WorldState
from .lattice import Region
from .renderer import Renderer
from .reuse import FrameReuse
from .visibility import Reach, seen_by

SensorT = TypeVar("SensorT", Camera, Lidar)


@dataclass(frozen=True)
class CaptureStates:
    """A drive's sensors, and the states that captures depend on. ``sees_all``: whether a frame depends on actors out of
    its view, too."""

    states: DriveStates
    reach: Reach
    sees_all: bool = False

    @property
    def drive(self) -> Drive:
        return self.states.drive

    def of_drive(self, drive: Drive) -> CaptureStates:
        """Return the states of another drive, rendered alike."""
        return replace(self, states=DriveStates(drive, self.states.parked))

    def state(self, sensor: Camera | Lidar, time_s: float) -> WorldState:
        """Return the state that a sensor's frame at ``time_s``, seconds, depends on."""
        state = self.states.state(*exposure_window(sensor, time_s))
        return state if self.sees_all else seen_by(state, sensor, self.reach)

    def camera(self, camera_id: str, width: int | None = None) -> Camera:
        """Return a camera of the drive, its images ``width`` pixels wide. Raises `SceneError`."""
        camera = _pick(self.drive.cameras, camera_id, "camera")
        return camera.resized(width) if width else camera

    def lidar(self, lidar_id: str) -> Lidar:
        """Return a LiDAR of the drive. Raises `SceneError`."""
        return _pick(self.drive.lidars, lidar_id, "LiDAR")


def states_of(renderer: Renderer, drive: Drive) -> CaptureStates:
    """Return the states that a renderer's captures of a drive depend on."""
    states = DriveStates(drive, renderer.backend.parked)
    return CaptureStates(states, renderer.reach, renderer.backend.sees_all)


Frame = CameraFrame | LidarFrame
StartCapture = Callable[[Capture], Callable[[], Frame]]
"""Begins a capture, and returns what waits for its frame."""


def start_capture(
    renderer: Renderer,
    states: CaptureStates,
    capture: Capture,
    passes: Sequence[str] = ("rgb",),
    width: int | None = None,
    draw: int | None = None,
    reuse: FrameReuse | None = None,
) -> Callable[[], Frame]:
    """Begin what a sensor of a drive measures on a GPU; return what waits for its frame, and what is not begun renders it
    then: `render_image` of a camera's capture, `render_sweep` of a LiDAR's."""
    if capture.sensor_id not in states.drive.cameras:
        lidar = states.lidar(capture.sensor_id)
        time_s = capture.time_s(lidar)
        if reuse is not None and reuse.may_reuse(lidar, time_s):
            return partial(render_sweep, renderer, states, capture, draw, reuse)
        seed = None if draw is None else capture.seed(draw)
        return renderer.start(states.state(lidar, time_s), lidar, time_s, seed=seed)
    camera = states.camera(capture.sensor_id, width)
    time_s = capture.time_s(camera)
    if reuse is not None and reuse.may_reuse(camera, time_s):
        return partial(render_image, renderer, states, capture, passes, width, reuse=reuse)
    return renderer.start(states.state(camera, time_s), camera, time_s, passes)


def render_capture(
    renderer: Renderer, states: CaptureStates, capture: Capture, passes: Sequence[str] = ("rgb",),
    width: int | None = None, draw: int | None = None, reuse: FrameReuse | None = None,
) -> Frame:  # fmt: skip
    """Render what a sensor of a drive measures, see `start_capture`."""
    return start_capture(renderer, states, capture, passes, width, draw, reuse)()


def started_ahead(start: StartCapture, captures: Iterable[Capture]) -> Iterator[Callable[[], Frame]]:
    """Yield what waits for each capture's frame, after the next one is begun: a GPU traces while frames are copied and
    written."""
    before: Callable[[], Frame] | None = None
    for capture in captures:
        begun = start(capture)
        if before is not None:
            yield before
        before = begun
    if before is not None:
        yield before


def render_image(
    renderer: Renderer,
    states: CaptureStates,
    capture: Capture,
    passes: Sequence[str] = ("rgb",),
    width: int | None = None,
    region: Region | None = None,
    reuse: FrameReuse | None = None,
) -> CameraFrame:
    """Render an image with these passes, ``width`` pixels wide (None: as recorded), or only its ``region``: the frame's
    arrays then have the region's size. ``reuse`` has the sensors' last frames: while a sensor stands, only what may
    differ is rendered."""
    camera = states.camera(capture.sensor_id, width)
    time_s = capture.time_s(camera)
    state = states.state(camera, time_s)
    if reuse is not None and region is None:
        return reuse.image(renderer, state, camera, time_s, passes)
    return renderer.render(state, camera, time_s, passes, region)


def render_sweep(
    renderer: Renderer,
    states: CaptureStates,
    capture: Capture,
    draw: int | None = None,
    reuse: FrameReuse | None = None,
) -> LidarFrame:
    """Render a sweep. ``draw`` and the capture seed the random draw of which beams return (`Capture.seed`); with None,
    beams return whose probability is 0.5 or more. ``reuse``: see `render_image`."""
    lidar = states.lidar(capture.sensor_id)
    time_s = capture.time_s(lidar)
    seed = None if draw is None else capture.seed(draw)
    state = states.state(lidar, time_s)
    if reuse is not None:
        return reuse.sweep(renderer, state, lidar, time_s, seed)
    return renderer.render(state, lidar, time_s, seed=seed)


def _pick(sensors: dict[str, SensorT], sensor_id: str, kind: str) -> SensorT:
    if sensor_id not in sensors:
        raise SceneError(f"no {kind} {sensor_id!r} in the drive: there are {', '.join(sensors) or 'none'}")
    return sensors[sensor_id]
