"""A Gymnasium environment: a vehicle driven through a scenario, both kinds of sensors in the observation.

Needs `gymnasium` (the extra ``gym``), to which it is known as ``UniSim-v0``.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from ..colour import bytes_from_srgb
from ..errors import SimulationError, short
from ..prepare.scenario_plan import RenderOptions
from ..scenario import build
from ..scenario.simulation import SimulationSpec
from ..sensors.frames import CameraFrame, LidarFrame
from ..world.drive import Lidar
from ..world.polyline import Polyline
from .actors.lead import touching
from .drivers.driver import Driver, DriverKind, DriverSetup
from .rollout.sensors import SimulatedSensors
from .rollout.setup import Simulation, open_scenario
from .states import EgoState
from .step import step
from .vehicle.actions import Control, array_of
from .world import World

FARTHEST_M = 1000.0
"""Largest coordinate of a place in an observation."""
CHANNELS = 5
"""Values of a sweep's cell: x, y, z in the LiDAR's frame (m), intensity (0 to 1), seconds before the sweep's time."""
ROUTE = 20
"""Points of the route ahead, some metres apart, in the frame of the rear axle."""
MOTION = ("speed_m_s", "acceleration_m_s2", "steering_rad")
COLLISION = 100.0
"""Penalty of a collision in the reward, in metres of progress."""
ASIDE_M = 10.0
"""Whoever is further from the route has left it."""


@dataclass(frozen=True, eq=False)
class Returns:
    """A sweep's returns, ``points`` (N, 5), see `CHANNELS`. Vector environments stack arrays, which need one shape."""

    points: NDArray[np.float32]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Returns) and np.array_equal(self.points, other.points)

    __hash__ = None  # type: ignore[assignment]


class UniSimEnv(gymnasium.Env[Any, NDArray[np.float32]]):
    """Drives through a scenario, or a log.

    Observation, a flat dict: ``camera/NAME`` (H, W, 3) uint8; ``lidar/NAME`` (beams, columns, 5) float32, see `CHANNELS`, 0
    where nothing returned; ``motion`` (3,), see `MOTION`; ``route`` (20, 2). Images and sweeps are the last that were delivered.
    Action (2,), each -1 to 1, shares of the vehicle's limits: how hard to accelerate or brake, and where to steer (left is
    positive).

    With ``range_image``, ``lidar/NAME`` is (rows, columns, 2) float32: the distance of a return from the LiDAR at the sweep's
    time, metres, and its intensity, 0 to 1; both 0 where nothing returned. True: a row a beam and a column a firing; (rows,
    columns): so many, none more than the LiDAR has, each cell with the nearest return of the beams and firings that fall in it.

    The reward is the progress along the route in metres, less 100 for a collision. An episode is terminated by a collision or
    further than 10 m from the route, and truncated where the simulation ends. ``info`` has the time, ``time_us``; of each LiDAR
    the `Returns`, ``points``; why the episode ended, ``ended``: "collision", "off_route", "time_over", or "" while it goes on;
    and the identifiers of the actors that the vehicle touches, ``collided_with``. A seed decides starts and actors;
    ``simulation`` holds members of a scenario's ``simulation``, which go before its own.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(
        self,
        scenario: str | Path,
        sensors: tuple[str, ...] | None = None,
        width: int | None = None,
        quality: str | None = None,
        renderer: str | None = None,
        device: str = "cpu",
        simulation: dict[str, Any] | None = None,
        render_mode: str | None = None,
        range_image: bool | tuple[int, int] = False,
    ) -> None:
        self.render_mode = render_mode
        options = RenderOptions(
            sensors=sensors, width=width, quality=quality, renderer=renderer, device=device, passes=("rgb",)
        )
        self._opened = open_scenario(Path(scenario), options)
        self._asked: SimulationSpec = build(SimulationSpec, simulation or {})
        context = self._simulation(0).context
        drive, self._vehicle = context.drive, context.vehicle
        self._cameras = {name: camera.resized(width) if width else camera for name, camera in drive.cameras.items()}
        self._lidars = dict(drive.lidars)
        self._range_sizes = {name: _range_size(lidar, range_image) for name, lidar in self._lidars.items()}
        self.observation_space = spaces.Dict(
            {
                **{
                    f"camera/{name}": spaces.Box(0, 255, (camera.model.height, camera.model.width, 3), np.uint8)
                    for name, camera in self._cameras.items()
                },
                **{
                    f"lidar/{name}": _sweep_space(lidar, self._range_sizes[name])
                    for name, lidar in self._lidars.items()
                },
                "motion": spaces.Box(-FARTHEST_M, FARTHEST_M, (len(MOTION),), np.float32),
                "route": spaces.Box(-FARTHEST_M, FARTHEST_M, (ROUTE, 2), np.float32),
            }
        )
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._run: Simulation | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Start an episode; the vehicle goes on as it started until every sensor has delivered."""
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(2**31))
        self._run = self._simulation(drawn)
        self._route = Polyline.through(self._run.setup().route)
        self._sensors = SimulatedSensors(self._run.plan, self._run.renderer, None)
        self._world: World = self._run.begin
        self._frames: dict[str, CameraFrame | LidarFrame] = {}
        wanted = {*self._cameras, *self._lidars}
        while wanted - self._frames.keys() and self._world.time_us < self._run.context.stop_us:
            self._advance(Control(0.0, self._world.ego.steering_rad))
        self._along_m = self._place(None)[0]
        return self._observation(), self._info("", ())

    def step(self, action: NDArray[np.float32]) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]:
        """Drive for a step."""
        assert self._run is not None, "an environment is reset before its first step"
        shares = array_of(action)
        if shares is None or shares.shape != (2,):
            raise SimulationError(f"action: must be two numbers from -1 to 1, not {short(action)}")
        pull, turn = (float(share) for share in np.clip(shares, -1.0, 1.0))
        most = self._vehicle.max_acceleration_m_s2 if pull > 0 else self._vehicle.max_deceleration_m_s2
        self._advance(Control(pull * most, turn * self._vehicle.max_steering_rad))
        along, aside = self._place(self._along_m)
        progress, self._along_m = along - self._along_m, along
        hit = touching(self._world.traffic.ego, self._world.traffic)
        truncated = self._world.time_us >= self._run.context.stop_us
        ended = "collision" if hit else "off_route" if aside > ASIDE_M else "time_over" if truncated else ""
        terminated = ended in ("collision", "off_route")
        reward = progress - COLLISION * bool(hit)
        return self._observation(), reward, terminated, truncated, self._info(ended, tuple(hit))

    def render(self) -> NDArray[np.uint8] | None:
        """Return the first camera's last image; None where there is no camera or no render mode."""
        if self.render_mode is None or not self._cameras:
            return None
        return self._image(next(iter(self._cameras)))

    def _simulation(self, seed: int) -> Simulation:
        kind = DriverKind("environment", "an environment's actions", _nobody)
        out = Path(tempfile.gettempdir())  # nothing is written
        return self._opened.simulation(replace(self._asked, seed=seed), kind, out)

    def _advance(self, action: Control) -> None:
        assert self._run is not None
        context, before = self._run.context, self._world.time_us
        self._world = step(self._world, action, context)
        ended = context.ended(before, self._world.time_us)
        if ended:
            since_us = min(exposure.start_us for exposure in ended)
            self._sensors.render(self._run.scenario_drive.drive_at(self._world, since_us), ended)
            self._frames |= self._sensors.frames

    def _place(self, near_m: float | None) -> tuple[float, float]:
        """How far along the route the rear axle is, near where it was, and how far from it, metres."""
        projection = self._route.project(self._world.ego.x_m, self._world.ego.y_m, near_m)
        return projection.along_m, projection.away_m

    def _observation(self) -> dict[str, NDArray[Any]]:
        ego = self._world.ego
        return {
            **{f"camera/{name}": self._image(name) for name in self._cameras},
            **{f"lidar/{name}": self._sweep(name) for name in self._lidars},
            "motion": np.array([getattr(ego, name) for name in MOTION], np.float32),
            "route": self._ahead(ego),
        }

    def _image(self, name: str) -> NDArray[np.uint8]:
        frame, model = self._frames.get(name), self._cameras[name].model
        if not isinstance(frame, CameraFrame):
            return np.zeros((model.height, model.width, 3), np.uint8)
        return bytes_from_srgb(frame.rgb)

    def _sweep(self, name: str) -> NDArray[np.float32]:
        frame, model = self._frames.get(name), self._lidars[name].model
        size = self._range_sizes[name]
        if size is not None:
            return _range_image(frame, size) if isinstance(frame, LidarFrame) else np.zeros((*size, 2), np.float32)
        grid = np.zeros((model.beams, model.columns, CHANNELS), np.float32)
        if isinstance(frame, LidarFrame):
            grid[frame.returned] = _points(frame)
        return grid

    def _ahead(self, ego: EgoState) -> NDArray[np.float32]:
        """The next points of the route (20, 2) as the rear axle sees them."""
        route = self._route.points
        first = int(np.searchsorted(self._route.along_m, self._along_m))
        points = route[np.minimum(first + np.arange(ROUTE), len(route) - 1)] - np.array([ego.x_m, ego.y_m])
        c, s = np.cos(ego.heading_rad), np.sin(ego.heading_rad)
        turned = points @ np.array([[c, -s], [s, c]])
        return np.clip(turned, -FARTHEST_M, FARTHEST_M).astype(np.float32)

    def _info(self, ended: str, hit: tuple[str, ...]) -> dict[str, Any]:
        points = {
            name: Returns(_points(frame)) for name, frame in self._frames.items() if isinstance(frame, LidarFrame)
        }
        return {"time_us": self._world.time_us, "points": points, "ended": ended, "collided_with": hit}


def _points(frame: LidarFrame) -> NDArray[np.float32]:
    """The returns (N, 5) of a sweep, beam by beam, see `CHANNELS`."""
    back = frame.returned
    world = frame.origins[back] + frame.directions[back] * frame.depth_m[back, None].astype(np.float64)
    pose = np.asarray(frame.world_from_lidar, np.float64)
    local = (world - pose[:3, 3]) @ pose[:3, :3]
    before = frame.time_s[back] - np.max(frame.time_s)
    points = np.concatenate([local, frame.intensity[back, None], before[:, None]], -1)
    return np.clip(points, -FARTHEST_M, FARTHEST_M).astype(np.float32)


def _sweep_space(lidar: Lidar, size: tuple[int, int] | None) -> spaces.Box:
    if size is not None:
        high = np.broadcast_to(np.array([FARTHEST_M, 1.0], np.float32), (*size, 2))
        return spaces.Box(np.zeros_like(high), high, dtype=np.float32)
    shape = (lidar.model.beams, lidar.model.columns, CHANNELS)
    return spaces.Box(-FARTHEST_M, FARTHEST_M, shape, np.float32)


def _range_size(lidar: Lidar, asked: bool | tuple[int, int]) -> tuple[int, int] | None:
    """Return the rows and columns of a LiDAR's range image, None where points are asked for. Raises `SimulationError`."""
    own = lidar.model.beams, lidar.model.columns
    if isinstance(asked, bool):
        return own if asked else None
    size = array_of(asked)
    if size is None or size.shape != (2,) or size.dtype.kind == "f" or (size < 1).any() or (size > own).any():
        raise SimulationError(
            f"range_image: must be True, or rows and columns up to the {own[0]} and {own[1]} of {lidar.sensor_id}, "
            f"not {short(asked)}"
        )
    return int(size[0]), int(size[1])


def _range_image(frame: LidarFrame, size: tuple[int, int]) -> NDArray[np.float32]:
    """Return distances and intensities (rows, columns, 2) of a sweep, the nearest return of each cell."""
    beam, column = np.nonzero(frame.returned)
    beams, columns = frame.returned.shape
    points = _points(frame)
    values = np.stack([np.linalg.norm(points[:, :3], axis=1), points[:, 3]], -1)
    far_first = np.argsort(
        -values[:, 0], kind="stable"
    )  # of several returns in a cell the last one that is written stays
    grid = np.zeros((*size, 2), np.float32)
    grid[(beam * size[0] // beams)[far_first], (column * size[1] // columns)[far_first]] = values[far_first]
    return np.clip(grid, 0.0, [FARTHEST_M, 1.0]).astype(np.float32)


def _nobody(setup: DriverSetup) -> Driver:
    raise AssertionError(f"the actions of an environment with {len(setup.sensors)} sensors come from outside")


if "UniSim-v0" not in gymnasium.registry:  # which `unisim_gymnasium` has seen to where the package is installed
    gymnasium.register("UniSim-v0", entry_point=f"{__name__}:UniSimEnv")
