"""What a rollout ends with: its scenario, whose rendering is what the driver saw, and its scores."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ...prepare.scenario_plan import RenderOptions, plan_scenario
from ...scenario import save_scenario
from ...scenario.sensors.document import Sensors
from ...scenario.times.document import Outside
from ...scenario.times.ranges import actors_outside
from ...scenario.types import Scenario
from ...sequence.run import RenderReport, render_sequence
from ...world.captures import SECOND_US, Key
from ..edits import edits_of
from ..world import recorded_keys
from .base import SCENARIO_NAME
from .loop import Rollout
from .setup import Simulation


def driven_scenario(simulation: Simulation, rollout: Rollout) -> Scenario:
    """Return the scenario of what was driven: the simulated one, with the trajectories that resulted and the captures' times."""
    stage, base = simulation.stage, simulation.scenario
    drive, before = simulation.scenario_drive.base, stage.drive.world_from_ego
    ego = rollout.ego_keys
    if ego and ego[0].time_s > before.times_s[0] and _starts_on_log(simulation):
        ego = (*recorded_keys(before, None, ego[0].time_s), *ego)
    actors = {
        uid: (*recorded_keys(drive.actors[uid].world_from_actor, None, keys[0].time_s), *keys)
        for uid, keys in rollout.keys.items()
    }
    moved = edits_of(simulation.scenario_drive, ego, actors, rollout.end.strayed, rollout.end.vanished_s)
    kept = simulation.scenario_drive.context.scenario.edits
    # where the vehicle goes is told to the end
    outside = Outside(actors_outside(base), "continue") if ego else base.outside
    times: dict[str, list[float]] = {}
    for one in stage.exposures:
        times.setdefault(one.capture.sensor_id, []).append(one.capture.time_us / SECOND_US)
    assert base.sensors is not None
    sensors = Sensors(
        tuple(replace(spec, times=tuple(sorted(times.get(spec.id, ())))) for spec in base.sensors.cameras or ()),
        tuple(replace(spec, times=tuple(sorted(times.get(spec.id, ())))) for spec in base.sensors.lidars or ()),
    )
    return replace(
        base, edits=(*kept, *moved), sensors=sensors, outside=outside, path=simulation.out / SCENARIO_NAME,
        simulation=replace(simulation.spec, jitter=None),  # its starts are drawn
        description=f"driven by {simulation.kind.name}",
    )  # fmt: skip


def _starts_on_log(simulation: Simulation) -> bool:
    jitter = simulation.spec.jitter
    return jitter is None or not any((jitter.ego_along_m, jitter.ego_aside_m, jitter.ego_yaw_deg, jitter.ego_speed_m_s))


def finish(
    simulation: Simulation,
    rollout: Rollout,
    options: RenderOptions,
    on_moment: Callable[[Key], object] = lambda key: None,
) -> RenderReport:
    """Write a rollout's scenario and make its folder the rendering of that scenario. What it rendered anew was not what the
    driver saw: there is none, unless files of the folder were changed."""
    scenario = driven_scenario(simulation, rollout)
    save_scenario(scenario, scenario.path)
    plan, _ = plan_scenario(scenario.path, replace(options, frames=None, times=None, sensors=None, scene=None))
    return render_sequence(plan, simulation.out, jobs=1, resume=True, on_moment=on_moment)
