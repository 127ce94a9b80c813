"""Simulation settings of a scenario's document: times, the vehicle, actors' models, sensors' rates, random starts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from .checks import require
from .json_schema import NOT_NEGATIVE, NUMBER, POSITIVE, TEXT, Schema, members_of, ref

OTHER_ACTORS = "*"
"""Name of all moving actors that are not named."""


@dataclass(frozen=True)
class RateSpec:
    """Capture times of a sensor: at ``phase_s`` and every ``period_s`` after it. A missing value is the recorded
    one."""

    period_s: float | None = None
    phase_s: float | None = None


@dataclass(frozen=True)
class Jitter:
    """Ranges of random starts around the recorded ones: uniform, up to these values to either side.

    The ego vehicle starts further along or aside, turned, or at another speed; actors start earlier or later.
    """

    ego_along_m: float | None = None
    ego_aside_m: float | None = None
    ego_yaw_deg: float | None = None
    ego_speed_m_s: float | None = None
    actors_s: float | None = None


@dataclass(frozen=True)
class SimulationSpec:
    """Settings of the simulation of `unisim drive`; the command line's options go before it.

    ``vehicle`` holds parameters of `vehicle.Vehicle`, ``actors`` the models of actors by id, "*" for the others.
    """

    start_s: float | None = None
    duration_s: float | None = None
    step_s: float | None = None
    delay_s: float | None = None
    seed: int | None = None
    vehicle: dict[str, Any] | None = field(default=None, hash=False)
    actors: dict[str, dict[str, Any]] | None = field(default=None, hash=False)
    rates: dict[str, RateSpec] | None = field(default=None, hash=False)
    jitter: Jitter | None = None


DEFS: dict[str, Schema] = {
    "simulation": members_of(
        {
            "start_s": {**NUMBER, "description": "When it starts. Where missing: at the first frame."},
            "duration_s": {**POSITIVE, "description": "Where missing: to the last frame."},
            "step_s": {"type": "number", "minimum": 0.01, "maximum": 10},
            "delay_s": {
                **NOT_NEGATIVE,
                "maximum": 10,
                "description": "So much later an answer of the driver takes effect.",
            },
            "seed": {"type": "integer", "minimum": 0},
            "vehicle": {"type": "object", "description": "Parameters of the ego vehicle."},
            "actors": {
                "type": "object",
                "propertyNames": TEXT,
                "additionalProperties": {"type": "object", "required": ["type"], "properties": {"type": TEXT}},
                "description": 'Models of actors by id; "*" is that of all moving ones that are not named.',
            },
            "rates": {"type": "object", "propertyNames": TEXT, "additionalProperties": ref("rate")},
            "jitter": ref("jitter"),
        },
        (),
        "How the scenario is simulated with a driver (`unisim drive`).",
    ),
    "rate": members_of({"period_s": {"type": "number", "minimum": 0.001, "maximum": 1000}, "phase_s": NUMBER}, ()),
    "jitter": members_of(
        dict.fromkeys(("ego_along_m", "ego_aside_m", "ego_yaw_deg", "ego_speed_m_s", "actors_s"), NOT_NEGATIVE),
        (),
        "Starts are drawn evenly, up to these values to either side of where they were recorded.",
    ),
}


def check_simulation(spec: SimulationSpec, place: str) -> None:
    """Raise `ScenarioError` for a delay that is no multiple of the step."""
    step, delay = spec.step_s or 0.1, spec.delay_s or 0.0
    steps = round(delay / step)
    require(
        abs(delay - steps * step) < 1e-6, f"{place}.delay_s", f"{delay:g} s must be a multiple of the step, {step:g} s"
    )
