"""The scenario that all drivers drive through: a scenario or a log, made to go on after its recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from unisim_blender.core.prepare.scenario_plan import RenderOptions, plan_scenario
from unisim_blender.core.scenario import rebased, save_scenario
from unisim_blender.core.scenario.simulation import OTHER_ACTORS, Jitter, RateSpec, SimulationSpec
from unisim_blender.core.scenario.time_range import Outside
from unisim_blender.core.scenario.times import recording_us
from unisim_blender.core.world.captures import US_PER_SECOND

JITTER = Jitter(ego_along_m=0.5, ego_aside_m=0.2, ego_speed_m_s=0.5, actors_s=0.2)
"""Starts of `--check-bytes`: rollouts of different seeds must differ."""


def write_asked(
    source: Path, options: RenderOptions, actors: str, period_s: float | None, out: Path, jitter: Jitter | None = None
) -> Path:
    """Write the scenario to file ``out`` and return its path: what moves goes on after the recording, moving actors that have no
    model have ``actors``, and sensors capture every ``period_s``, None as they did. Raises `UnisimError`."""
    plan, prepared = plan_scenario(source, options)
    scenario = rebased(prepared.scenario, out)
    own = scenario.simulation or SimulationSpec()
    rates = own.rates
    if period_s is not None:
        rates = dict.fromkeys((*plan.settings.cameras, *plan.settings.lidars), RateSpec(period_s))
    models = {OTHER_ACTORS: {"type": actors}, **(own.actors or {})}
    spec = replace(own, actors=models, rates=rates, jitter=jitter or own.jitter)
    outside = scenario.outside or Outside("continue", "continue")
    out.parent.mkdir(parents=True, exist_ok=True)
    save_scenario(replace(scenario, outside=outside, simulation=spec), out)
    return out


def seconds_for(path: Path, options: RenderOptions, drives: bool, wanted_s: float) -> float:
    """Return for how long a driver drives: as wanted, or to the recording's end where it follows the log."""
    _, prepared = plan_scenario(path, options)
    if drives:
        return wanted_s
    first_us, last_us = recording_us(prepared.edited)
    spec = prepared.scenario.simulation or SimulationSpec()
    left_s = last_us / US_PER_SECOND - (first_us / US_PER_SECOND if spec.start_s is None else spec.start_s)
    return min(wanted_s, left_s)
