"""What became of the vehicle's way and of its sensors."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from ...core.errors import ScenarioError
from ...core.geometry import FloatArray, invert_pose, quaternion_from_matrix
from ...core.scenario.edit import Edit
from ...core.scenario.edits import Ego
from ...core.scenario.keys import Keyframe, ShiftKey
from ...core.scenario.placement import Offset
from ...core.scenario.sensors import CameraSpec, LidarSpec, Sensors, Shutter
from ...core.world.drive import CameraModel, Drive, LidarModel, RollingShutter
from ..sampled.clock import Clock
from ..sampled.poses import SAME_M, optical, same, same_place, same_turn
from ..sampled.scene import Sampled
from ..sampled.scene import SampledObject as Thing
from ..sensors.mounts import lag, lidar_json, lidar_model, recorded_mount, sensor_clock
from .trajectories import keyframes, placement, quaternion, vector

Spec = TypeVar("Spec", CameraSpec, LidarSpec)


def ego_edits(sampled: Sampled, drive: Drive) -> Iterator[Edit]:
    """None where the vehicle drives as recorded; a shift where it drives beside that, else a new trajectory."""
    for ego in sampled.of("EGO"):
        base = drive.world_from_ego.at(sampled.clock.times_s)
        if same(ego.poses, base).all():
            return
        apart = np.einsum("nji,nj->ni", base[:, :3, :3], (ego.poses - base)[:, :3, 3])
        ahead, left, up = np.abs(apart[:, 0]).max(), apart[:, 1], np.abs(apart[:, 2]).max()
        if same_turn(ego.poses, base).all() and max(ahead, up, np.ptp(left)) <= 2 * SAME_M:
            yield Ego(shift_left_m=round(float(left.mean()), 6))
        elif same_turn(ego.poses, base).all() and max(ahead, up) <= 2 * SAME_M:
            yield Ego(shift=shift_keys(sampled.clock, left))
        else:
            yield Ego(trajectory=keyframes(sampled.clock, ego.poses, np.ones(len(ego.poses), bool)))
        return


def shift_keys(clock: Clock, left_m: FloatArray) -> tuple[ShiftKey, ...]:
    """Keys of a shift (N,) to the left: of the frames, those at which its rate changes."""
    rate = np.diff(left_m) / np.diff(clock.times_s)
    turns = np.concatenate([[True], np.abs(np.diff(rate)) * np.diff(clock.times_s)[1:] > SAME_M, [True]])
    return tuple(ShiftKey(round(float(left_m[i]), 6), frame=int(clock.frames[i])) for i in np.flatnonzero(turns))


def sensors_of(sampled: Sampled, drive: Drive) -> Sensors | None:
    """The sensors to render; None where they are those of the log, as they were."""
    clock = sampled.clock
    ego = next(sampled.of("EGO"), None)
    if ego is None and any(sampled.of("CAMERA", "LIDAR")):
        raise ScenarioError(
            f'scene "{sampled.name}": has no ego vehicle, which its sensors are mounted on: undo that it was deleted, '
            "or import the drive again"
        )
    world_from_ego = drive.world_from_ego.at(clock.times_s) if ego is None else ego.poses
    cameras = tuple(
        _sighted(_camera(thing, world_from_ego, drive, clock), thing, sampled)
        for thing in sampled.of("CAMERA")
        if thing.there.any()
    )
    lidars = tuple(
        _sighted(_lidar(thing, world_from_ego, drive, clock), thing, sampled)
        for thing in sampled.of("LIDAR")
        if thing.there.any()
    )
    untouched = {CameraSpec(name) for name in drive.cameras}, {LidarSpec(name) for name in drive.lidars}
    if (set(cameras), set(lidars)) == untouched:
        return None
    return Sensors(None if set(cameras) == untouched[0] else cameras, None if set(lidars) == untouched[1] else lidars)


def _sighted(spec: Spec, thing: Thing, sampled: Sampled) -> Spec:
    """A sensor's entry, which says whether it sees the ego vehicle's body where a scenario would take it otherwise."""
    taken_as = spec.trajectory is not None
    if thing.sees_body == taken_as or not any(sampled.of("BODY")):
        return spec
    return replace(spec, sees_ego_body=thing.sees_body)


def sensor_id(thing: Thing, drive: Drive) -> str:
    """What a scenario calls a sensor: as the log does, or after the object; names of files are made of it."""
    return sensor_name(thing.title, thing.uid, thing.is_original, drive)


def sensor_name(title: str, uid: str, is_original: bool, drive: Drive) -> str:
    """Return a scenario's name of a sensor: the id in the log where it is an original, else one made of its title."""
    recorded = uid in drive.cameras or uid in drive.lidars
    return uid if recorded and is_original else safe_name(title)


def safe_name(text: str) -> str:
    """A name of a sensor that a file's name can be made of."""
    return re.sub(r"[^A-Za-z0-9_.-]|^[.-]", "_", text)


def _camera(thing: Thing, world_from_ego: FloatArray, drive: Drive, clock: Clock) -> CameraSpec:
    base = drive.cameras.get(thing.uid)
    assert thing.camera is not None  # a thing of kind CAMERA is a camera
    late = lag(base, drive, clock)
    now = late @ invert_pose(world_from_ego) @ optical(thing.poses)
    name = sensor_id(thing, drive)
    if base is None:
        spec = CameraSpec(name, **intrinsics(thing.camera), **_mount(now, optical(thing.poses), clock))
    else:
        spec = CameraSpec(name, like=None if name == thing.uid else thing.uid)
        if thing.camera != base.model:
            spec = replace(spec, **intrinsics(thing.camera))
        if not same(now, (mount := late @ recorded_mount(base, drive, clock))).all():
            spec = replace(spec, **_moved(now, mount, optical(thing.poses), sensor_clock(base, clock)))
    return spec


def _lidar(thing: Thing, world_from_ego: FloatArray, drive: Drive, clock: Clock) -> LidarSpec:
    base = drive.lidars.get(thing.uid)
    late = lag(base, drive, clock)
    now = late @ invert_pose(world_from_ego) @ thing.poses
    name = sensor_id(thing, drive)
    model = lidar_model(thing.model)
    if base is None:
        return LidarSpec(name, **_beams(model), **_mount(now, thing.poses, clock))
    spec = LidarSpec(name, like=None if name == thing.uid else thing.uid)
    if lidar_json(model) != lidar_json(base.model):
        spec = replace(spec, **_beams(model))
    if not same(now, (mount := late @ recorded_mount(base, drive, clock))).all():
        spec = replace(spec, **_moved(now, mount, thing.poses, sensor_clock(base, clock)))
    return spec


def _moved(now: FloatArray, mount: FloatArray, world: FloatArray, clock: Clock) -> dict[str, Any]:
    """A sensor of the log in another place on the vehicle, or on a way of its own."""
    apart = (now - mount)[:, :3, 3]
    turned = now[:, :3, :3] @ np.swapaxes(mount[:, :3, :3], -1, -2)
    turns = np.tile(np.eye(4), (len(now), 1, 1))
    turns[:, :3, :3] = turned
    rigid = not (np.ptp(apart, axis=0) > 2 * SAME_M).any() and same_turn(turns, turns[:1]).all()
    # where training has a mount waver, one that is displaced wavers with it
    displaced = invert_pose(mount) @ now
    if not rigid and not same(displaced, displaced[:1]).all():
        return {"trajectory": free_way(clock, world)}
    unmoved = bool(same_place(now, mount).all())
    unturned = bool(same_turn(now, mount).all())
    return {
        "mount_offset": Offset(
            position=None if unmoved else vector(apart.mean(0)),
            quaternion_wxyz=None if unturned else quaternion(quaternion_from_matrix(turned[len(turned) // 2])),
        )
    }


def _mount(now: FloatArray, world: FloatArray, clock: Clock) -> dict[str, Any]:
    """A new sensor's place on the vehicle, or a way of its own."""
    if same(now, now[:1]).all():
        return {"mount": placement(now[0])}
    return {"trajectory": free_way(clock, world)}


def free_way(clock: Clock, world: FloatArray) -> tuple[Keyframe, ...]:
    """Keys of a sensor that does not ride on the vehicle: poses (N, 4, 4) at the clock's times. One that stands still has one."""
    still = bool(same(world, world[:1]).all())
    return tuple(
        Keyframe(
            time_s=max(0.0, float(time)),
            position=vector(pose[:3, 3]),
            quaternion_wxyz=quaternion(quaternion_from_matrix(pose[:3, :3])),
        )
        for i, (time, pose) in enumerate(zip(clock.times_s, world, strict=True))
        if (i == 0 if still else time >= 0.0)
    )


def intrinsics(model: CameraModel) -> dict[str, Any]:
    """A camera model as members of a `CameraSpec`."""
    shutter = None if model.shutter == RollingShutter() else Shutter(model.shutter.duration_s, model.shutter.reference)
    return {
        "width": model.width, "height": model.height, "fx": model.fx, "fy": model.fy, "cx": model.cx, "cy": model.cy,
        "shutter": shutter,
    }  # fmt: skip


def _beams(model: LidarModel) -> dict[str, Any]:
    return {
        "elevation_deg": tuple(np.degrees(model.elevation_rad).tolist()),
        "azimuth_offset_deg": tuple(np.degrees(model.azimuth_offset_rad).tolist()),
        "columns": model.columns,
        "sweep_s": model.sweep_s,
        "start_azimuth_deg": float(np.degrees(model.start_azimuth_rad)),
        "direction": model.direction,
        "time_offset_s": model.time_offset_s,
        "min_range_m": model.min_range_m,
        "max_range_m": model.max_range_m,
    }
