"""What a simulation has moved, as a scenario's edits, and the drive with them: what sensors see is what the scenario says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from ..scenario.apply import select_frames
from ..scenario.context import Context
from ..scenario.edit import Edit
from ..scenario.edits.ego import Ego
from ..scenario.edits.move import Move
from ..scenario.motion.keys import Keyframe, Present
from ..scenario.sensors.select import select_sensors
from ..scenario.types import Scenario
from ..world.captures import SECOND_US
from ..world.drive import Camera, Drive, Lidar
from .world import KEPT_S, Keys, World

AHEAD_S = 0.25
"""So much of recorded trajectories behind a world's time is kept, beside what lies before it."""


def edits_of(
    drive: Drive, ego: Keys, actors: Mapping[str, Keys], strayed: frozenset[str], vanished_s: Mapping[str, float]
) -> list[Edit]:
    """Return the edits that say where a simulation has moved the ego vehicle and actors: along these keys, in ``drive``, which
    has the scenario's own edits. An actor that strayed stays after its recorded end, until it vanishes."""
    edits: list[Edit] = []
    if ego:
        edits.append(Ego(trajectory=_keyframes(ego), outside="continue"))
    for uid, keys in actors.items():
        present = None
        if uid in strayed:
            first = min(drive.time_s.values())
            start = drive.actors[uid].start_s
            present = Present(start if start > first else None, vanished_s.get(uid))
        edits.append(Move(actor=uid, trajectory=_keyframes(keys), present=present))
    return edits


def without_driven(edits: tuple[Edit, ...]) -> tuple[Edit, ...]:
    """Return a scenario's edits without the ego vehicle's trajectories, of which a simulation that moves the vehicle gives the
    last one: its sensors then ride on that from where they were recorded, with the same bits in every rollout."""
    return tuple(edit for edit in edits if not (isinstance(edit, Ego) and edit.trajectory is not None))


def _keyframes(keys: Keys) -> tuple[Keyframe, ...]:
    return tuple(
        Keyframe(position=key.position_m, quaternion_wxyz=key.quaternion_wxyz, time_s=key.time_s) for key in keys
    )


@dataclass(frozen=True, eq=False)
class ScenarioDrive:
    """A scenario's drive before its sensors are chosen (``base``), to which a simulation's edits are applied.

    ``context`` is the scenario's: its log's drive, and where other scenes' actors come from.
    """

    base: Drive
    context: Context

    @staticmethod
    def of(scenario: Scenario, context: Context) -> ScenarioDrive:
        """Return that of a scenario. Raises `ScenarioError`."""
        drive = context.recorded
        for index, edit in enumerate(scenario.edits):
            drive = edit.apply(drive, f"{scenario.path}: edits[{index}]", context)
        return ScenarioDrive(select_frames(drive, scenario), context)

    def drive(self) -> Drive:
        """Return the scenario's drive before anything is simulated."""
        return select_sensors(self.base, self.context)

    def with_edits(self, edits: list[Edit]) -> Drive:
        """Return the drive with edits after the scenario's own."""
        drive = self.base
        for index, edit in enumerate(edits):
            drive = edit.apply(drive, f"simulation: edits[{index}]", self.context)
        return select_sensors(drive, self.context)

    def drive_at(self, world: World) -> Drive:
        """Return the drive of a world. It holds for exposures that end at the world's time or up to `KEPT_S` before it: only keys
        around these are worked with."""
        time_s = world.time_us / SECOND_US
        near = ScenarioDrive(_cropped(self.base, time_s - KEPT_S, time_s + AHEAD_S), self.context)
        found = near.with_edits(edits_of(self.base, world.ego_keys, world.keys, world.strayed, world.vanished_s))
        times = self._times_s
        return replace(
            found,
            time_s=self.base.time_s,
            cameras={name: replace(one, time_s=times[name]) for name, one in found.cameras.items()},
            lidars={name: replace(one, time_s=times[name]) for name, one in found.lidars.items()},
        )

    @cached_property
    def _times_s(self) -> dict[str, dict[int, float]]:
        drive = self.drive()
        sensors: dict[str, Camera | Lidar] = {**drive.cameras, **drive.lidars}
        return {name: one.time_s for name, one in sensors.items()}


def _cropped(drive: Drive, start_s: float, end_s: float) -> Drive:
    """Return a drive with the keys alone that poses between two times depend on, and the times of the frames between them."""
    cameras: dict[str, Camera] = {
        name: replace(one, world_from_camera=one.world_from_camera.between(start_s, end_s))
        for name, one in drive.cameras.items()
    }
    lidars: dict[str, Lidar] = {
        name: replace(one, world_from_lidar=one.world_from_lidar.between(start_s, end_s))
        for name, one in drive.lidars.items()
    }
    ego = drive.world_from_ego.between(start_s, end_s)
    first = drive.frames[0]
    inside = {frame: time_s for frame, time_s in drive.time_s.items() if start_s <= time_s <= end_s}
    return replace(
        drive, time_s=inside or {first: (start_s + end_s) / 2}, world_from_ego=ego, cameras=cameras, lidars=lidars
    )
