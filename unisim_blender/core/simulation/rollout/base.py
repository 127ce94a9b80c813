"""The scenario that a rollout begins with: with all that the simulation decides, and lying in the rollout's folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...scenario.edit import Edit
from ...scenario.edits.retime import Retime
from ...scenario.rebase import rebased
from ...scenario.sensors.document import CameraSpec, LidarSpec, Sensors
from ...scenario.simulation.document import SimulationSpec
from ...scenario.times.document import Outside
from ...scenario.types import Outputs, Scenario
from ...world.drive import Drive

BASE_NAME = "simulated.json"
SCENARIO_NAME = "scenario.json"


def base_scenario(
    scenario: Scenario, drive: Drive, spec: SimulationSpec, sensors: tuple[str, ...], outputs: Outputs, out: Path
) -> Scenario:
    """Return the scenario that is simulated, in folder ``out``; ``drive`` is that of ``scenario``.

    Its sensors are those named, it has no frames or times, actors start as ``spec.jitter`` draws it, and the vehicle goes on
    outside the recording.
    """
    moved = drawn_starts(drive, spec)
    found = rebased(scenario, out / BASE_NAME)
    outside = scenario.outside or Outside("absent", "continue")
    return replace(
        found,
        frames=None,
        times=None,
        outside=outside,
        sensors=_listed(scenario.sensors, drive, sensors),
        edits=(*found.edits, *moved),
        outputs=outputs,
        simulation=spec,
    )


def drawn_starts(drive: Drive, spec: SimulationSpec) -> list[Edit]:
    """Return the edits by which moving actors start earlier or later, drawn by the seed and each actor's id."""
    most = (spec.jitter.actors_s if spec.jitter else None) or 0.0
    if not most:
        return []
    return [
        Retime(actor=uid, offset_s=round(float(generator(spec.seed or 0, uid).uniform(-most, most)), 6))
        for uid, actor in sorted(drive.actors.items())
        if actor.is_moving and not actor.is_ego_body
    ]


def generator(seed: int, uid: str) -> np.random.Generator:
    """Return the random generator of a start, from the simulation's seed and what starts."""
    return np.random.default_rng([seed, len(uid), *uid.encode()])


def _listed(sensors: Sensors | None, drive: Drive, wanted: tuple[str, ...]) -> Sensors:
    cameras = {spec.id: replace(spec, times=None) for spec in (sensors.cameras if sensors else None) or ()}
    lidars = {spec.id: replace(spec, times=None) for spec in (sensors.lidars if sensors else None) or ()}
    return Sensors(
        tuple(cameras.get(name) or CameraSpec(name) for name in drive.cameras if name in wanted),
        tuple(lidars.get(name) or LidarSpec(name) for name in drive.lidars if name in wanted),
    )
