"""Simulation settings of a scenario's document: times, the vehicle, actors' models, sensors' rates, random starts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

from .checks import require
from .json_schema import NOT_NEGATIVE, NUMBER, POSITIVE, TEXT, NotNegative, Schema, SchemaOf, object_of, ref

OTHER_ACTORS = "*"
"""Name of all moving actors that are not named."""
DELAY: Schema = {**NOT_NEGATIVE, "maximum": 10}
VEHICLE: Schema = {"type": "object", "description": "Parameters of the ego vehicle."}
ACTORS: Schema = {
    "type": "object",
    "propertyNames": TEXT,
    "additionalProperties": {"type": "object", "required": ["type"], "properties": {"type": TEXT}},
    "description": 'Models of actors by id; "*" is that of all moving ones that are not named.',
}
RATES: Schema = {"type": "object", "propertyNames": TEXT, "additionalProperties": ref("rate")}


def _said(about: str, schema: Schema = NUMBER) -> SchemaOf:
    return SchemaOf({**schema, "description": about})


@dataclass(frozen=True)
class RateSpec:
    """Capture times of a sensor: at ``phase_s`` and every ``period_s`` after it. A missing value is the recorded
    one."""

    period_s: Annotated[float, SchemaOf({"type": "number", "minimum": 0.001, "maximum": 1000})] | None = None
    phase_s: float | None = None


@dataclass(frozen=True)
class Jitter:
    """Ranges of random starts around the recorded ones: uniform, up to these values to either side.

    The ego vehicle starts further along or aside, turned, or at another speed; actors start earlier or later.
    """

    ego_along_m: NotNegative | None = None
    ego_aside_m: NotNegative | None = None
    ego_yaw_deg: NotNegative | None = None
    ego_speed_m_s: NotNegative | None = None
    actors_s: NotNegative | None = None


@dataclass(frozen=True)
class SimulationSpec:
    """Settings of the simulation of `unisim drive`; the command line's options go before it.

    ``vehicle`` holds parameters of `vehicle.Vehicle`, ``actors`` the models of actors by id, "*" for the others.
    """

    start_s: Annotated[float, _said("When it starts. Where missing: at the first frame.")] | None = None
    duration_s: Annotated[float, _said("Where missing: to the last frame.", POSITIVE)] | None = None
    step_s: Annotated[float, SchemaOf({"type": "number", "minimum": 0.01, "maximum": 10})] | None = None
    delay_s: Annotated[float, _said("So much later an answer of the driver takes effect.", DELAY)] | None = None
    seed: int | None = None
    vehicle: Annotated[dict[str, Any], SchemaOf(VEHICLE)] | None = field(default=None, hash=False)
    actors: Annotated[dict[str, dict[str, Any]], SchemaOf(ACTORS)] | None = field(default=None, hash=False)
    rates: Annotated[dict[str, RateSpec], SchemaOf(RATES)] | None = field(default=None, hash=False)
    jitter: Jitter | None = None


DEFS: dict[str, Schema] = {
    "simulation": object_of(SimulationSpec, "How the scenario is simulated with a driver (`unisim drive`)."),
    "rate": object_of(RateSpec),
    "jitter": object_of(
        Jitter, "Starts are drawn evenly, up to these values to either side of where they were recorded."
    ),
}


def check_simulation(spec: SimulationSpec, place: str) -> None:
    """Raise `ScenarioError` for a delay that is no multiple of the step."""
    step, delay = spec.step_s or 0.1, spec.delay_s or 0.0
    steps = round(delay / step)
    require(
        abs(delay - steps * step) < 1e-6, f"{place}.delay_s", f"{delay:g} s must be a multiple of the step, {step:g} s"
    )
