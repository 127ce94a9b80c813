"""Run a rollout: the driver is asked, the world makes a step, what its sensors delivered is rendered and written."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, field

from ...errors import OutputError
from ..clock import Exposure
from ..drivers.driver import CameraImage, CheckedDriver, Driver, EgoMotion, LidarSweep, Observation
from ..step import advance_world, enqueue_action, step
from ..world import Action, PoseKey, World
from .sensors import SensorSource, SimulatedSensors, capture_name, moment_of
from .setup import Simulation, single_threaded_torch
from .steps import RolloutStep, append_step, read_steps

KEY_NUMBERS = 8
"""A time, a position and a quaternion."""
Delivered = tuple[list[CameraImage], list[LidarSweep]]
"""Sensor data that are delivered in a step."""


@dataclass(frozen=True, eq=False)
class Rollout:
    """Result of a rollout: its ``steps``, the start first, and all keys of what was moved."""

    steps: tuple[RolloutStep, ...]
    ego_keys: tuple[PoseKey, ...]
    keys: Mapping[str, tuple[PoseKey, ...]]
    end: World


@dataclass
class _Known:
    """Keys as numbers in a row, which take a sixth of the memory."""

    values: array[float] = field(default_factory=lambda: array("d"))

    def extend(self, keys: Iterable[PoseKey]) -> None:
        """Take in the keys that are new."""
        last = self.values[-KEY_NUMBERS] if self.values else -math.inf
        for key in keys:
            if key.time_s > last:
                self.values.extend((key.time_s, *key.position_m, *key.quaternion_wxyz))

    def keys(self) -> tuple[PoseKey, ...]:
        rows = (self.values[at : at + KEY_NUMBERS] for at in range(0, len(self.values), KEY_NUMBERS))
        return tuple(PoseKey(time_s, (x, y, z), (a, b, c, d)) for time_s, x, y, z, a, b, c, d in rows)


@dataclass
class _History:
    """Collects the keys that worlds forget."""

    ego: _Known = field(default_factory=_Known)
    actors: dict[str, _Known] = field(default_factory=dict)

    def note(self, world: World) -> None:
        """Take in the keys that are new."""
        self.ego.extend(world.ego_keys)
        for uid, keys in world.keys.items():
            self.actors.setdefault(uid, _Known()).extend(keys)


@single_threaded_torch()
def roll_out(
    simulation: Simulation, on_step: Callable[[World], object] = lambda world: None, sensors: SensorSource | None = None
) -> Rollout:
    """Drive from the start to the end of a simulation; what the folder holds of it already is not rendered again.

    Where answers take effect after a delay, what sensors record next is rendered while the driver thinks: the same bytes.
    ``on_step`` is called after each step, with the world. ``sensors`` deliver in place of the simulation's own
    (`SimulatedSensors`), for example `HiddenActors`. The driver is closed in every case. Raises `UnisimError`; what is finished
    stays in the folder.
    """
    out, context = simulation.out, simulation.context
    known = read_steps(out)
    sensors = sensors or SimulatedSensors(simulation.plan, simulation.renderer, out)
    driver = CheckedDriver.started(simulation.kind, simulation.setup(), out)
    history, world = _History(), simulation.begin
    history.note(world)
    steps = [known[0] if known else RolloutStep.of(world, None, (), {}, {})]
    if not known:
        append_step(out, steps[0])
    elif steps[0].ego != world.ego:
        raise OutputError(f"{out}: its rollout starts elsewhere; name another folder")
    delivered: Delivered = ([], [])
    # one thread renders: what it renders and when does not depend on how long the driver takes
    rendering = ThreadPoolExecutor(1, "rendering") if context.delay_us > 0 else None
    try:
        while world.time_us < context.stop_us:
            traffic = world.traffic if simulation.kind.privileged else None
            images, sweeps = delivered
            motion = (EgoMotion(world.time_us, world.ego),)
            seen = Observation(world.time_us, tuple(images), tuple(sweeps), motion, traffic)
            done = known[len(steps)] if len(steps) < len(known) else None
            if rendering is None:
                action = driver.drive(seen) if done is None else _again(driver, seen, done)
                before, world = world, step(world, action, context)
                delivered = _delivered(simulation, sensors, before, world, done)
            else:  # the answer is not needed until later: the next exposures are decided already
                before, world = world, advance_world(world, context)
                waiting = rendering.submit(_delivered, simulation, sensors, before, world, done)
                try:
                    action = driver.drive(seen) if done is None else _again(driver, seen, done)
                finally:
                    wait([waiting])
                delivered = waiting.result()
                world = enqueue_action(world, action, before.time_us, context)
            history.note(world)
            if done is None:
                ended = context.ended(before.time_us, world.time_us)
                done = RolloutStep.of(
                    world, action, names_of(simulation, ended), sensors.unsupported, sensors.confidence
                )
                append_step(out, done)
            elif done.ego != world.ego:
                raise OutputError(f"{out}: step {len(steps)} of its rollout cannot be repeated; name another folder")
            steps.append(done)
            on_step(world)
    finally:
        if rendering is not None:
            rendering.shutdown()
        driver.close()
    keys = {uid: known.keys() for uid, known in history.actors.items()}
    return Rollout(tuple(steps), history.ego.keys(), keys, world)


def _again(driver: Driver, seen: Observation, done: RolloutStep) -> Action:
    """Return the action of a step that an earlier run made; the driver sees the step, too."""
    action = driver.drive(seen)
    return action if done.action is None else done.action


def _delivered(
    simulation: Simulation, sensors: SensorSource, before: World, world: World, done: RolloutStep | None
) -> Delivered:
    """Return what sensors deliver of a step: rendered, or from the files of an earlier run."""
    ended = simulation.context.ended(before.time_us, world.time_us)
    drive = simulation.context.drive
    if ended:
        drive = simulation.scenario_drive.drive_at(world, min(exposure.start_us for exposure in ended))
    return sensors.render(drive, ended) if done is None else sensors.read(drive, ended)


def names_of(simulation: Simulation, exposures: Iterable[Exposure]) -> tuple[str, ...]:
    """Return the names of exposures' captures: "camera/front_camera/t0000001050000us"."""
    drive = simulation.context.drive
    captures = [exposure.capture for exposure in exposures]
    return tuple(f"{capture_name(drive, capture)[0]}/{moment_of(drive, capture).name}" for capture in captures)
