"""The steps of a rollout as lines of JSON: what the vehicle was asked for, and where everything was."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import OutputError, UnisimError, in_a_line, refused
from ..actors.model import ActorMotion
from ..states import EgoState
from ..vehicle.actions import Control, Plan
from ..world import Action, FollowLog, World

STEPS_NAME = "steps.jsonl"
BASE_NAME = "simulated.json"
"""The scenario that a rollout begins with."""
SCENARIO_NAME = "scenario.json"
"""The scenario of the drive that resulted."""


@dataclass(frozen=True, eq=False)
class RolloutStep:
    """One step: the ``action`` that answered the moment ``asked_us`` (None at the start), and the world that followed.

    ``captures`` names what was delivered at its end, "camera/front_camera/t0000001050000us"; ``unsupported`` the share of
    unsupported pixels of each image among these, by camera; ``confidence`` the mean confidence of pixels or returns, by sensor.
    """

    time_us: int
    ego: EgoState
    actors: Mapping[str, dict[str, Any]]
    action: Action | None = None
    captures: tuple[str, ...] = ()
    unsupported: Mapping[str, float] = field(default_factory=dict)
    confidence: Mapping[str, float] = field(default_factory=dict)

    @staticmethod
    def of(
        world: World, action: Action | None, captures: tuple[str, ...], unsupported: Mapping[str, float],
        confidence: Mapping[str, float],
    ) -> RolloutStep:  # fmt: skip
        """Return the step that led to a world."""
        actors = {uid: actor_to_json(motion) for uid, motion in world.motions.items() if motion.state.present}
        return RolloutStep(world.time_us, world.ego, actors, action, captures, dict(unsupported), dict(confidence))

    def to_json(self) -> dict[str, Any]:
        return {
            "time_us": self.time_us,
            "action": None if self.action is None else action_to_json(self.action),
            "ego": asdict(self.ego),
            "actors": dict(self.actors),
            "captures": list(self.captures),
            "unsupported": dict(self.unsupported),
            "confidence": dict(self.confidence),
        }

    @staticmethod
    def from_json(values: Any) -> RolloutStep:
        """Return the step of `to_json`. Raises ValueError, KeyError or TypeError for anything else."""
        action = values["action"]
        return RolloutStep(
            int(values["time_us"]),
            EgoState(**values["ego"]),
            values["actors"],
            None if action is None else action_from_json(action),
            tuple(values["captures"]),
            values["unsupported"],
            values.get("confidence", {}),  # rollouts before it was measured have none
        )


def actor_to_json(motion: ActorMotion) -> dict[str, Any]:
    """Return an actor's state as a JSON object."""
    state = motion.state
    return {
        "position_m": list(state.position_m),
        "quaternion_wxyz": list(state.quaternion_wxyz),
        "speed_m_s": state.speed_m_s,
        "acceleration_m_s2": state.acceleration_m_s2,
    }


def action_to_json(action: Action) -> dict[str, Any]:
    """Return an action as a JSON object."""
    if isinstance(action, Control):
        return {"type": "control", **asdict(action)}
    if isinstance(action, Plan):
        return {
            "type": "plan",
            "times_us": action.times_us.tolist(),
            "x_m": action.x_m.tolist(),
            "y_m": action.y_m.tolist(),
            "heading_rad": action.heading_rad.tolist(),
            **({} if action.speed_m_s is None else {"speed_m_s": action.speed_m_s.tolist()}),
        }
    return {"type": "log"}


def action_from_json(values: Any) -> Action:
    """Return the action of `action_to_json`. Raises ValueError, KeyError or TypeError, or `SimulationError` for bad numbers."""
    kind = values["type"]
    if kind == "control":
        return Control(values["acceleration_m_s2"], values["steering_rad"])
    if kind == "plan":
        times = np.array(values["times_us"], np.int64)
        return Plan(times, values["x_m"], values["y_m"], values["heading_rad"], values.get("speed_m_s"))
    if kind == "log":
        return FollowLog()
    raise ValueError(f"there is no action {kind!r}")


def append_step(out: Path, step: RolloutStep) -> None:
    """Write a step behind those that are there. Raises `OutputError`."""
    with refused(out / STEPS_NAME, "written", OutputError):
        with (out / STEPS_NAME).open("a", encoding="utf-8") as file:
            file.write(json.dumps(step.to_json()) + "\n")


def read_steps(out: Path, mends: bool = True) -> list[RolloutStep]:
    """Return the steps of a rollout's folder without a last line that was cut off, which is taken away from the file where this
    ``mends`` it. Raises `OutputError`."""
    path = out / STEPS_NAME
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return []
    except OSError as error:
        raise OutputError(f"{path}: cannot be read: {error.strerror}") from error
    whole = content[: content.rfind(b"\n") + 1]
    if mends and len(whole) < len(content):
        path.write_bytes(whole)
    return [_step(path, number, line) for number, line in enumerate(whole.splitlines(), 1)]


def stream_steps(out: Path) -> Iterator[RolloutStep]:
    """Yield the steps of a finished rollout's folder one by one; none where it is no rollout's. Raises `OutputError`."""
    path = out / STEPS_NAME
    try:
        with path.open("rb") as file:
            for number, line in enumerate(file, 1):
                yield _step(path, number, line)
    except FileNotFoundError:
        return
    except OSError as error:
        raise OutputError(f"{path}: cannot be read: {error.strerror}") from error


def _step(path: Path, number: int, line: bytes) -> RolloutStep:
    try:
        return RolloutStep.from_json(json.loads(line))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, UnisimError) as error:
        raise OutputError(f"{path}: line {number} is no step of a rollout: {in_a_line(error)}") from error
