"""The scores of a rollout."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...data.classes import motion_of
from ...geometry import FloatArray
from ..scores.record import PlanRecord, Record
from ..scores.summary import summarise
from ..states import ActorState, Footprint
from ..step import actor_footprint
from ..vehicle.actions import Plan
from ..vehicle.footprint import footprint_of
from .loop import Rollout
from .setup import Simulation
from .steps import Step

SCORES_NAME = "scores.json"


def scores_of(simulation: Simulation, rollout: Rollout) -> dict[str, Any]:
    """Return all scores of a rollout as a JSON object, see `scores.summary.summarise`, and what made it."""
    found = summarise(record_of(simulation, rollout))
    head = {
        "driver": simulation.kind.name,
        "privileged": simulation.kind.privileged,
        "seed": simulation.spec.seed or 0,
        "delay_s": simulation.stage.delay_us / 1e6,
        "step_s": simulation.stage.step_us / 1e6,
    }
    return head | found


def record_of(simulation: Simulation, rollout: Rollout) -> Record:
    """Return a rollout as scores read it."""
    stage, steps = simulation.stage, rollout.steps
    drive, vehicle = stage.drive, stage.vehicle
    axle = np.eye(4)
    axle[:3, 3] = vehicle.rear_axle_m
    plans = [
        PlanRecord(before.time_us, step.action.times_us, _poses(step.action))
        for before, step in zip(steps, steps[1:], strict=False)
        if isinstance(step.action, Plan)
    ]
    actors = [actor for actor in drive.actors.values() if not actor.is_ego_body]
    return Record(
        np.array([step.time_us for step in steps]),
        tuple(step.ego for step in steps),
        tuple(footprint_of(step.ego, vehicle) for step in steps),
        tuple(_footprints(simulation, step) for step in steps),
        drive.world_from_ego.transformed(right=axle),
        tuple(plans) or None,
        tuple(float(np.mean(list(step.unsupported.values()))) if step.unsupported else None for step in steps),
        tuple(
            actor.world_from_actor.positions[:, :2]
            for actor in actors
            if actor.is_moving and motion_of(actor.label, simulation.classes) == "rigid"
        ),
        None,
        simulation.classes or {},
    )


def _poses(plan: Plan) -> FloatArray:
    return np.stack([plan.x_m, plan.y_m, plan.heading_rad], -1)


def _footprints(simulation: Simulation, step: Step) -> tuple[Footprint, ...]:
    stage = simulation.stage
    moving = [
        actor_footprint(stage.drive.actors[uid], ActorState(**_as_state(values))) for uid, values in step.actors.items()
    ]
    return (*moving, *stage.recording.standing.footprints)


def _as_state(values: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
