"""The digest of what labels depend on: it differs wherever the labels do, and stays where nothing of them changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from tiny_drive import tiny_plan

from unisim_blender.core.geometry import make_pose
from unisim_blender.core.output.frame_files import labels_bytes, labels_digest
from unisim_blender.core.world.captures import Moment
from unisim_blender.core.world.drive import Actor, Appearance, Box, Drive, StaticCopy

PLAN = tiny_plan()
DRIVE = PLAN.drive
SENSORS = (tuple(DRIVE.cameras), tuple(DRIVE.lidars))
MOMENTS = [*(PLAN.moment_of_frame(frame) for frame in (0, 2)), Moment.at(DRIVE, 150_000, *SENSORS)]
UID = next(iter(DRIVE.actors))


def with_actor(change: Callable[[Actor], Actor]) -> Drive:
    return replace(DRIVE, actors={**DRIVE.actors, UID: change(DRIVE.actors[UID])})


def moved(actor: Actor) -> Actor:
    track = actor.world_from_actor
    return replace(actor, world_from_actor=replace(track, positions=track.positions + [0.0, 1e-9, 0.0]))


def looking(drive: Drive, **changes: object) -> Drive:
    cameras = {name: replace(camera, **changes) for name, camera in drive.cameras.items()}  # type: ignore[arg-type]
    return replace(drive, cameras=cameras)


BOX = Box(np.eye(4), np.ones(3))
CHANGES = {
    "nothing": DRIVE,
    "appearance": with_actor(lambda one: replace(one, appearance=Appearance("another", "/elsewhere"))),
    "place": with_actor(moved),
    "size": with_actor(lambda one: replace(one, size_m=one.size_m * 2)),
    "label": with_actor(lambda one: replace(one, label="another")),
    "moving": with_actor(lambda one: replace(one, is_moving=not one.is_moving)),
    "inserted": with_actor(lambda one: replace(one, inserted=True)),
    "ego body": with_actor(lambda one: replace(one, is_ego_body=True)),
    "gone": with_actor(lambda one: replace(one, end_s=-5.0, start_s=-6.0)),
    "ends soon": with_actor(lambda one: replace(one, end_s=0.16)),
    "another": replace(DRIVE, actors={**DRIVE.actors, "b": replace(DRIVE.actors[UID], uid="b")}),
    "first": replace(DRIVE, actors={"0": replace(DRIVE.actors[UID], uid="0"), **DRIVE.actors}),
    "copy": replace(DRIVE, static_copies=(StaticCopy("copy", BOX, make_pose(np.ones(3), np.array([1.0, 0, 0, 0]))),)),
    "origin": replace(DRIVE, world_origin=DRIVE.world_origin + 1.0),
    "ego": replace(DRIVE, world_from_ego=replace(DRIVE.world_from_ego, positions=DRIVE.world_from_ego.positions + 0.1)),
    "camera": replace(DRIVE, cameras={}),
    "later": looking(DRIVE, time_s={frame: time + 0.01 for frame, time in DRIVE.time_s.items()}),
    "body": looking(DRIVE, sees_ego_body=True),
}


@pytest.mark.parametrize("moment", MOMENTS, ids=[moment.name for moment in MOMENTS])
def test_digests_differ_where_labels_do(moment: Moment) -> None:
    if moment.frame is None:
        named = {name: drive for name, drive in CHANGES.items() if name != "camera"}
    else:
        named = CHANGES
    digests = {name: labels_digest(drive, moment) for name, drive in named.items()}
    labels = {name: labels_bytes(drive, moment) for name, drive in named.items()}
    for name in named:
        if labels[name] != labels["nothing"]:
            assert digests[name] != digests["nothing"], name
    assert digests["appearance"] == digests["nothing"], "what actors look like is no part of labels"
    by_digest: dict[str, set[bytes]] = {}
    for name in named:
        by_digest.setdefault(digests[name], set()).add(labels[name])
    assert all(len(some) == 1 for some in by_digest.values()) and len(by_digest) >= len(named) - 5


def test_moments_differ() -> None:
    assert len({labels_digest(DRIVE, moment) for moment in MOMENTS}) == len(MOMENTS)
