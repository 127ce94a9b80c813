"""Read OpenSCENARIO: trajectories, places, speeds and presence as edits of a log's scenario. What is not understood is listed."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import ScenarioError, in_a_line, short
from ...geometry import FloatArray, Trajectory, invert_pose, quaternion_from_matrix
from ...prepare.scenario import prepare_scenario
from ...scenario import save_scenario
from ...scenario.edit import Edit
from ...scenario.edits.ego import Ego
from ...scenario.edits.move import Move
from ...scenario.edits.remove import Remove
from ...scenario.motion.keys import Keyframe, Present
from ...scenario.motion.placement import Placement
from ...scenario.rebase import rebased
from ...simulation.rollout.base import SCENARIO_NAME
from ...simulation.states import EGO
from ...simulation.vehicle.parameters import Vehicle
from ...world.drive import Drive
from .events import Centre, Track, tracks_of
from .reference import EGO_NAMES, pose_at, shifted

MOST_BYTES = 64 << 20
SAME_M, SAME_RAD, SAME_S = 1e-3, 1e-4, 1e-3
"""What differs by less from the log is no edit."""
LONGEST_LIST = 200
"""So many sentences are given at most."""


@dataclass
class _Found:
    edits: list[Edit] = field(default_factory=list)
    losses: list[str] = field(default_factory=list)


def read(path: Path, base: Path, folder: Path, out: Path) -> tuple[str, tuple[str, ...]]:
    """Write the scenario of an OpenSCENARIO file into ``folder``, which becomes ``out``: its name, and a sentence for each part
    that is not understood. ``base`` is what it edits. Raises `UnisimError`."""
    prepared = prepare_scenario(base)
    spec = prepared.scenario.simulation
    vehicle = Vehicle.from_dict((spec.vehicle if spec else None) or {}, f"{base}: simulation.vehicle")
    found = edits_of(parsed(path), prepared.edited, vehicle, path)
    final = Path(os.path.abspath(out)) / SCENARIO_NAME
    scenario = rebased(prepared.scenario, final)
    scenario = replace(scenario, edits=(*scenario.edits, *found.edits), description=f"edits of {path.name}")
    save_scenario(scenario, folder / SCENARIO_NAME)
    losses = found.losses[:LONGEST_LIST]
    if len(found.losses) > LONGEST_LIST:
        losses.append(f"{len(found.losses) - LONGEST_LIST} more parts are not understood")
    return SCENARIO_NAME, tuple(losses)


def parsed(path: Path) -> ElementTree.Element:
    """Return the root of an OpenSCENARIO file. Raises `ScenarioError`; entities of its own are refused unread."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}") from error
    if len(data) > MOST_BYTES:
        raise ScenarioError(f"{path}: has {len(data)} bytes, more than {MOST_BYTES}")
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data or data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise ScenarioError(f"{path}: has a DOCTYPE or entities of its own, which are not read")
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError, RecursionError) as error:
        raise ScenarioError(f"{path}: is no XML: {in_a_line(error)}") from error
    if root.tag != "OpenSCENARIO":
        raise ScenarioError(f"{path}: is no OpenSCENARIO: its root is {short(root.tag)}")
    header = root.find("FileHeader")
    if header is None or header.get("revMajor") != "1":
        raise ScenarioError(f"{path}: FileHeader: revMajor must be 1")
    return root


def edits_of(root: ElementTree.Element, drive: Drive, vehicle: Vehicle, path: Path) -> _Found:
    """Return the edits that make a drive what an OpenSCENARIO file says, and what of it is not understood. Actors that the file
    does not have are removed. Raises `ScenarioError` for numbers that are none."""
    found = _Found()
    span_s = drive.time_s[drive.frames[0]], drive.time_s[drive.frames[-1]]
    tracks, found.losses = tracks_of(root, path, span_s, lambda name, centre: _recorded(name, centre, drive, vehicle))
    there = set()
    for name, track in tracks.items():
        if name in EGO_NAMES and name not in drive.actors:
            there.add(EGO)
            _edit_ego(track, drive, vehicle, found)
        elif name in drive.actors:
            there.add(name)
            _edit_actor(name, track, drive, found)
        else:
            found.losses.append(f"entity {short(name)}: the log has no such actor")
    for uid, actor in sorted(drive.actors.items()):
        if uid not in there and not actor.is_ego_body:
            found.edits.append(Remove(actor=uid))
    return found


def _recorded(name: str, centre: Centre, drive: Drive, vehicle: Vehicle) -> Trajectory | None:
    """Return the recorded trajectory of an entity's reference point; ``centre`` is where its box's middle is from there."""
    if name in drive.actors:
        return drive.actors[name].world_from_actor.transformed(right=invert_pose(shifted(centre)))
    return drive.world_from_ego.transformed(right=vehicle.ego_from_axle) if name in EGO_NAMES else None


def _edit_ego(track: Track, drive: Drive, vehicle: Vehicle, found: _Found) -> None:
    ego_from_axle = invert_pose(vehicle.ego_from_axle)
    poses = [pose_at(one) @ ego_from_axle for one in track.positions]
    if len(poses) < 2 or _same(track.times_s, poses, drive.world_from_ego):
        return
    found.edits.append(Ego(trajectory=_keys(track.times_s, poses), outside="continue"))


def _edit_actor(uid: str, track: Track, drive: Drive, found: _Found) -> None:
    actor, box = drive.actors[uid], shifted(track.centre)
    poses = [pose_at(one) @ box for one in track.positions]
    first, last = (drive.time_s[drive.frames[end]] for end in (0, -1))
    start, end = drive.window(actor)
    present = None
    appears = first if track.appears_s is None else track.appears_s
    vanishes = last if track.vanishes_s is None else track.vanishes_s
    if abs(max(start, first) - appears) > SAME_S or abs(min(end, last) - vanishes) > SAME_S:
        present = Present(track.appears_s, track.vanishes_s)
    elif not poses or _same(track.times_s, poses, actor.world_from_actor):
        return
    if not poses:
        poses, times = list(actor.world_from_actor.poses), actor.world_from_actor.times_s.tolist()
    else:
        times = track.times_s
    if len(poses) == 1:
        position, quaternion = _placed(poses[0])
        found.edits.append(
            Move(actor=uid, pose=Placement(position=position, quaternion_wxyz=quaternion), present=present)
        )
    else:
        found.edits.append(Move(actor=uid, trajectory=_keys(times, poses), present=present))


def _same(times_s: list[float], poses: list[FloatArray], recorded: Trajectory) -> bool:
    there = recorded.at(np.array(times_s))
    ours = np.stack(poses)
    near = np.abs(ours[:, :3, 3] - there[:, :3, 3]).max() < SAME_M
    return bool(near and np.abs(ours[:, :3, :3] - there[:, :3, :3]).max() < SAME_RAD)


def _keys(times_s: list[float], poses: list[FloatArray]) -> tuple[Keyframe, ...]:
    keys = []
    for time_s, pose in zip(times_s, poses, strict=True):
        position, quaternion = _placed(pose)
        keys.append(Keyframe(position=position, quaternion_wxyz=quaternion, time_s=time_s))
    return tuple(keys)


def _placed(pose: FloatArray) -> tuple[Any, Any]:
    return tuple(pose[:3, 3].tolist()), tuple(quaternion_from_matrix(pose[:3, :3]).tolist())
