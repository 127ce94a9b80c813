"""The scores of a rollout."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...geometry import BoolArray, FloatArray
from ...render.tracer import NEAR_M
from ...sensors.rays import Rays
from ...world.captures import US_PER_SECOND
from ...world.classes import motion_of
from ..scores.off_road import Occupied, RoadTest, in_corridor
from ..scores.record import PlanRecord, Record
from ..scores.summary import summarise
from ..states import ActorState, EgoState, Footprint, actor_footprint
from ..vehicle.actions import Plan
from ..vehicle.parameters import footprint_of
from .loop import Rollout
from .setup import Simulation, single_threaded_torch
from .steps import RolloutStep

SCORES_NAME = "scores.json"
MATTER_M = 0.1
"""Distance from a point, metres, within which what a ray meets is the point's own matter."""


@single_threaded_torch()
def scores_of(simulation: Simulation, rollout: Rollout) -> dict[str, Any]:
    """Return all scores of a rollout as a JSON object, see `scores.summary.summarise`, and what made it."""
    record = record_of(simulation, rollout)
    scores = summarise(record, occupied=occupancy_of(simulation), on_road=labelled_road(simulation, record))
    head = {
        "driver": simulation.kind.name,
        "privileged": simulation.kind.privileged,
        "seed": simulation.spec.seed or 0,
        "delay_s": simulation.context.delay_us / 1e6,
        "step_s": simulation.context.step_us / 1e6,
    }
    return head | scores


def record_of(simulation: Simulation, rollout: Rollout) -> Record:
    """Return a rollout as scores read it."""
    context, steps = simulation.context, rollout.steps
    drive, vehicle = context.drive, context.vehicle
    plans = [
        PlanRecord(before.time_us, plan.times_us, np.stack([plan.x_m, plan.y_m, plan.heading_rad], -1))
        for before, step in zip(steps, steps[1:], strict=False)
        if isinstance(plan := step.action, Plan)
    ]
    actors = [actor for actor in drive.actors.values() if not actor.is_ego_body]
    return Record(
        np.array([step.time_us for step in steps]),
        tuple(step.ego for step in steps),
        tuple(footprint_of(step.ego, vehicle) for step in steps),
        tuple(footprints_at(simulation, step) for step in steps),
        drive.world_from_ego.transformed(right=vehicle.ego_from_axle),
        tuple(plans) or None,
        tuple(float(np.mean(list(step.unsupported.values()))) if step.unsupported else None for step in steps),
        tuple(float(np.mean(list(step.confidence.values()))) if step.confidence else None for step in steps),
        tuple(
            actor.world_from_actor.positions[:, :2]
            for actor in actors
            if actor.is_moving and motion_of(actor.label, simulation.classes) == "rigid"
        ),
        _on_ground(simulation, [step.ego for step in steps]),
        simulation.classes or {},
    )


def occupancy_of(simulation: Simulation) -> Occupied:
    """Return what tells which points lie in the static scene's matter, world frame.

    Short rays along the world's x and y begin before the point and end within `MATTER_M` there. Actors are no part of it.
    """
    renderer, time_s = simulation.renderer, simulation.context.start_us / US_PER_SECOND
    state = simulation.plan.captures.states.state(time_s, time_s).restricted(())

    def occupied(points: FloatArray) -> BoolArray:
        hit = np.zeros(len(points), bool)
        for direction in np.eye(3)[:2]:
            directions = np.broadcast_to(direction, points.shape)
            # a tracer looks from NEAR_M on
            rays = Rays(points - (NEAR_M + MATTER_M / 2) * direction, directions, np.full(len(points), time_s))
            depth = renderer.beams(state, rays)[0]
            hit |= (depth > 0) & (depth < NEAR_M + MATTER_M)
        return hit

    return occupied


def labelled_road(simulation: Simulation, record: Record) -> RoadTest | None:
    """Return what tells which points are on the road by the log's labels, and in the corridor of recorded paths where these say
    nothing; None where the log has none. Raises `LogError`."""
    cells = simulation.road()
    if cells is None:
        return None

    def on_road(points: FloatArray) -> BoolArray:
        on, known = cells.look_up(points)
        on[~known] = in_corridor(record, points[~known])
        return on

    return on_road


def _on_ground(simulation: Simulation, states: list[EgoState]) -> FloatArray:
    """Poses (T, 4, 4) of the ground beneath the middle of the rear axle."""
    context = simulation.context
    poses = context.poses_of(states) @ context.vehicle.ego_from_axle
    above = context.heights(poses[:, :3, 3])
    poses[:, 2, 3] -= np.where(np.isfinite(above), above, 0.0)
    return poses


def footprints_at(simulation: Simulation, step: RolloutStep) -> tuple[Footprint, ...]:
    """Return the footprints of all actors that are present at a step."""
    context = simulation.context
    moving = [
        actor_footprint(context.drive.actors[uid], ActorState(**_as_state(values)))
        for uid, values in step.actors.items()
    ]
    return (*moving, *context.standing)


def _as_state(values: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
