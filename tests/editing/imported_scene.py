"""A sampled scene as an import leaves it, from plain data, and edits of it: what Blender's tools do to
poses and presence."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.world.drive import Actor, Drive
from unisim_blender.editing.sampled.clock import Clock, recorded_poses, recorded_there
from unisim_blender.editing.sampled.scene import Sampled, SampledObject, optical
from unisim_blender.editing.sensors.mounts import lidar_json, recorded_mount


def sampled_object(name: str, kind: str, poses: FloatArray, there: Any = True, **more: Any) -> SampledObject:
    """Return an object at poses (N, 4, 4), present throughout or at the frames ``there`` (N,); what it is
    called is its id."""
    about: dict[str, Any] = {
        "uid": name,
        "original_name": name,
        "appearance": "",
        "appearance_scene": "",
        "model": "",
        "index": 0,
        **more,
    }
    return SampledObject(name=name, kind=kind, poses=poses, there=np.broadcast_to(there, len(poses)).copy(), **about)


def imported(drive: Drive) -> Sampled:
    """Return the drive's vehicle, sensors and actors at its frames, as they were imported."""
    clock = Clock.of(drive)
    ego = drive.world_from_ego.at(clock.times_s)
    objects = [sampled_object("Ego vehicle", "EGO", ego, uid="ego")]
    for uid, camera in drive.cameras.items():
        world = optical(ego @ recorded_mount(camera, drive, clock))
        objects.append(sampled_object(uid, "CAMERA", world, camera=camera.model))
    for uid, lidar in drive.lidars.items():
        world = ego @ recorded_mount(lidar, drive, clock)
        objects.append(sampled_object(uid, "LIDAR", world, model=lidar_json(lidar.model)))
    for uid, actor in drive.actors.items():
        there = recorded_there(actor, drive, clock)
        objects.append(
            sampled_object(uid, "ACTOR", recorded_poses(actor, clock), there, size_m=tuple(actor.size_m.tolist()))
        )
    return Sampled("drive", clock, tuple(sorted(objects, key=lambda one: one.name)))


def one_of(sampled: Sampled, name: str) -> SampledObject:
    """Return the object of a name."""
    return next(one for one in sampled.objects if one.name == name)


def changed(sampled: Sampled, name: str, **values: Any) -> Sampled:
    """Return the scene with other values of one object."""
    return replace(
        sampled, objects=tuple(replace(one, **values) if one.name == name else one for one in sampled.objects)
    )


def without(sampled: Sampled, name: str) -> Sampled:
    """Return the scene with an object deleted."""
    return replace(sampled, objects=tuple(one for one in sampled.objects if one.name != name))


def added(sampled: Sampled, *new: SampledObject) -> Sampled:
    """Return the scene with more objects."""
    return replace(sampled, objects=tuple(sorted([*sampled.objects, *new], key=lambda one: one.name)))


def displaced(poses: FloatArray, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> FloatArray:
    """Return poses (N, 4, 4) displaced in the world's axes."""
    apart = poses.copy()
    apart[:, :3, 3] += (x, y, z)
    return apart


def beside(poses: FloatArray, ahead: float = 0.0, left: float = 0.0, yaw_deg: float = 0.0) -> FloatArray:
    """Return poses (N, 4, 4) displaced and turned in their own axes."""
    c, s = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    return np.asarray(poses @ np.array([[c, -s, 0, ahead], [s, c, 0, left], [0, 0, 1, 0], [0, 0, 0, 1.0]]))


def driving(drive: Drive, label: str = "Car") -> Actor:
    """Return the first actor by id of a class that drives."""
    return next(actor for _, actor in sorted(drive.actors.items()) if actor.is_moving and label in actor.label)


def standing(drive: Drive, label: str = "Car") -> Actor:
    """Return the first actor by id of a class that stands still."""
    return next(actor for _, actor in sorted(drive.actors.items()) if not actor.is_moving and label in actor.label)
