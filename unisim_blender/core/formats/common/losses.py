"""What of a scenario no other format says."""

from __future__ import annotations

from ...scenario.types import Scenario
from ...world.drive import Drive

NAMED = 5


def losses_of(scenario: Scenario, drive: Drive, sensors: bool) -> list[str]:
    """Return a sentence for each part of a scenario, and of its edited drive, that a format without appearances leaves out;
    ``sensors``: whether it has none for sensors either."""
    found = []
    foreign = [uid for uid, one in drive.actors.items() if one.appearance.mesh or one.appearance.scene]
    if foreign:
        found.append(f"where {named(foreign)} look as they do: meshes and other scenes' actors are not written")
    if any(one.is_ego_body for one in drive.actors.values()):
        found.append("the ego vehicle's body: its mesh is not written")
    if drive.static_copies or len(drive.static_removals):
        found.append("copied and removed boxes of the static world are not written")
    if sensors and scenario.sensors is not None:
        found.append("the scenario's sensors are not written")
    if scenario.simulation is not None and scenario.simulation.actors:
        found.append("the actors' models of simulation.actors are not written: they go as the edits have them")
    return found


def named(names: list[str]) -> str:
    """Return names in a sentence, the first few where there are many."""
    shown = ", ".join(names[:NAMED])
    return shown if len(names) <= NAMED else f"{shown} and {len(names) - NAMED} more"
