"""Run a rollout: the driver is asked, the world makes a step, what its sensors delivered is rendered and written."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from ...errors import OutputError
from ..clock import Exposure
from ..observations import EgoMotion, Image, Observation, Sweep
from ..step import step
from ..world import Key, World
from .sensors import Sensors, SimulatedSensors, capture_name, moment_of
from .setup import Simulation
from .steps import Step, append_step, read_steps


@dataclass(frozen=True, eq=False)
class Rollout:
    """What a rollout left: its ``steps``, the start first, and all keys of what was moved."""

    steps: tuple[Step, ...]
    ego_keys: tuple[Key, ...]
    keys: Mapping[str, tuple[Key, ...]]
    end: World


@dataclass
class _History:
    """Collects the keys that worlds forget."""

    ego: list[Key] = field(default_factory=list)
    actors: dict[str, list[Key]] = field(default_factory=dict)

    def note(self, world: World) -> None:
        """Take in the keys that are new."""
        _extend(self.ego, world.ego_keys)
        for uid, keys in world.keys.items():
            _extend(self.actors.setdefault(uid, []), keys)


def _extend(known: list[Key], keys: Iterable[Key]) -> None:
    last = known[-1].time_s if known else None
    known += [key for key in keys if last is None or key.time_s > last]


def roll_out(
    simulation: Simulation,
    on_step: Callable[[World], object] = lambda world: None,
    sensors: Sensors | None = None,
) -> Rollout:
    """Drive from the start to the end of a simulation; what the folder holds of it already is not rendered again.

    ``on_step`` is called after each step, with the world. ``sensors`` deliver in place of the simulation's own
    (`SimulatedSensors`), for example `HiddenActors`. The driver is closed in every case. Raises `UnisimError`; what is finished
    stays in the folder.
    """
    out, stage = simulation.out, simulation.stage
    known = read_steps(out)
    sensors = sensors or SimulatedSensors(simulation.plan, simulation.renderer, out)
    driver = simulation.kind.start(simulation.setup())
    history, world = _History(), simulation.begin
    history.note(world)
    steps = [known[0] if known else Step.of(world, None, (), {})]
    if not known:
        append_step(out, steps[0])
    elif steps[0].ego != world.ego:
        raise OutputError(f"{out}: its rollout starts elsewhere; name another folder")
    images: list[Image] = []
    sweeps: list[Sweep] = []
    motion = [EgoMotion(world.time_us, world.ego)]
    try:
        while world.time_us < stage.stop_us:
            traffic = world.traffic if simulation.kind.privileged else None
            action = driver.drive(Observation(world.time_us, tuple(images), tuple(sweeps), tuple(motion), traffic))
            done = known[len(steps)] if len(steps) < len(known) else None
            if done is not None and done.action is not None:
                action = done.action
            before, world = world, step(world, action, stage)
            history.note(world)
            ended = stage.ended(before.time_us, world.time_us)
            drive = simulation.scenario_drive.drive_at(world) if ended else stage.drive
            images, sweeps = sensors.render(drive, ended) if done is None else sensors.read(drive, ended)
            motion = [EgoMotion(world.time_us, world.ego)]
            if done is None:
                done = Step.of(world, action, names_of(simulation, ended), sensors.unsupported)
                append_step(out, done)
            elif done.ego != world.ego:
                raise OutputError(f"{out}: step {len(steps)} of its rollout cannot be repeated; name another folder")
            steps.append(done)
            on_step(world)
    finally:
        driver.close()
    keys = {uid: tuple(keys) for uid, keys in history.actors.items()}
    return Rollout(tuple(steps), tuple(history.ego), keys, world)


def names_of(simulation: Simulation, exposures: Iterable[Exposure]) -> tuple[str, ...]:
    """Return the names of exposures' captures: "camera/front_camera/t0000001050000us"."""
    drive = simulation.stage.drive
    captures = [one.capture for one in exposures]
    return tuple(f"{capture_name(drive, one)[0]}/{moment_of(drive, one).name}" for one in captures)
