"""Reads the sensors: those of the log, changed ones and new ones. They are no edits but a member of their
own of a scenario."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from ...core.errors import ScenarioError
from ...core.geometry import FloatArray, invert_pose, quaternion_from_matrix
from ...core.scenario.edit import Edit
from ...core.scenario.motion.keys import Keyframe
from ...core.scenario.motion.placement import Offset
from ...core.scenario.sensors.document import CameraSpec, LidarSpec, Sensors
from ...core.scenario.sensors.select import camera_members, lidar_members
from ...core.world.drive import Camera, Drive, Lidar
from ..edits.lines import EditLine, degrees, line_of, moved_words
from ..edits.reader import GroupReader, ReadContext, register
from ..edits.trajectories import placement, quaternion, vector
from ..sampled.clock import Clock
from ..sampled.scene import SAME_M, Sampled, SampledObject, optical, same, same_place, same_turn
from ..sensors.mounts import lag, lidar_json, lidar_model, recorded_mount
from ..sensors.names import sensor_id
from ..texts import Text, series

Spec = TypeVar("Spec", CameraSpec, LidarSpec)


@register
class SensorReader(GroupReader):
    """Reads what of the sensors is not as in the log."""

    group = "RIG"
    kinds = ("CAMERA", "LIDAR")

    def edits(self, reading: ReadContext) -> Iterator[Edit]:
        """None: sensors are not among a scenario's edits."""
        return iter(())

    def lines(self, reading: ReadContext, uid: str) -> Iterator[EditLine]:
        """A line for each sensor that is gone, another one, or new."""
        sampled, drive, clock = reading.sampled, reading.drive, reading.clock
        always = np.ones(len(clock.frames), bool)
        sensors = sensors_of(sampled, drive)
        listed: dict[str, tuple[CameraSpec | LidarSpec, ...] | None] = {
            "CAMERA": sensors.cameras if sensors else None,
            "LIDAR": sensors.lidars if sensors else None,
        }
        for kind, specs in listed.items():
            if specs is None:
                continue
            recorded = set(drive.cameras if kind == "CAMERA" else drive.lidars)
            named = Text("Camera" if kind == "CAMERA" else "LiDAR")
            standing = [obj for obj in sampled.of(kind) if obj.there.any()]
            for name in sorted(recorded - sampled.skipped - {spec.id for spec in specs}):
                hidden = next((obj.name for obj in sampled.of(kind) if obj.uid == name and obj.is_original), "")
                yield line_of(
                    kind, name, "REMOVE", Text("{sensor} removed", sensor=named), (name, hidden), always, clock, name
                )
            for spec, obj in zip(specs, standing, strict=True):
                names = obj.title, obj.name
                if spec in (CameraSpec(spec.id), LidarSpec(spec.id)) and spec.id in recorded:
                    continue
                if spec.id in recorded and spec.like is None:
                    yield line_of(kind, spec.id, "SENSOR", sensor_words(named, spec), names, always, clock, spec)
                else:
                    what = Text("{sensor} copied" if spec.like else "{sensor} added", sensor=named)
                    yield line_of(kind, obj.uid, "INSERT", what, names, always, clock, spec)

    def edited_ids(self, reading: ReadContext) -> set[str]:
        """Recorded sensors that are gone or other ones. A vehicle that was deleted took its sensors along: nothing
        of them is kept."""
        sampled, drive = reading.sampled, reading.drive
        sensors = (sensors_of(sampled, drive) if any(sampled.of("EGO")) else None) or Sensors()
        edited: set[str] = set()
        if sensors.cameras is not None:
            edited |= set(drive.cameras) - {spec.id for spec in sensors.cameras if spec == CameraSpec(spec.id)}
        if sensors.lidars is not None:
            edited |= set(drive.lidars) - {spec.id for spec in sensors.lidars if spec == LidarSpec(spec.id)}
        return edited - sampled.skipped


def sensors_of(sampled: Sampled, drive: Drive) -> Sensors | None:
    """The sensors to render; None where they are those of the log, as they were. Sensors that were not imported are not
    rendered."""
    clock = sampled.clock
    ego = next(sampled.of("EGO"), None)
    if ego is None and any(sampled.of("CAMERA", "LIDAR")):
        raise ScenarioError(
            f'scene "{sampled.name}": has no ego vehicle, which its sensors are mounted on: undo that it was deleted, '
            "or import the drive again"
        )
    world_from_ego = drive.world_from_ego.at(clock.times_s) if ego is None else ego.poses
    standing = [obj for obj in sampled.of("CAMERA", "LIDAR") if obj.there.any()]
    cameras = tuple(
        _sighted(_camera(obj, world_from_ego, drive, clock), obj, sampled) for obj in standing if obj.kind == "CAMERA"
    )
    lidars = tuple(
        _sighted(_lidar(obj, world_from_ego, drive, clock), obj, sampled) for obj in standing if obj.kind == "LIDAR"
    )
    untouched = {CameraSpec(name) for name in drive.cameras}, {LidarSpec(name) for name in drive.lidars}
    if (set(cameras), set(lidars)) == untouched:
        return None
    return Sensors(None if set(cameras) == untouched[0] else cameras, None if set(lidars) == untouched[1] else lidars)


def _sighted(spec: Spec, obj: SampledObject, sampled: Sampled) -> Spec:
    """A sensor's entry, which says whether it sees the ego vehicle's body where a scenario would take it otherwise."""
    taken_as = spec.trajectory is not None
    if obj.sees_body == taken_as or not any(sampled.of("BODY")):
        return spec
    return replace(spec, sees_ego_body=obj.sees_body)


def _camera(obj: SampledObject, world_from_ego: FloatArray, drive: Drive, clock: Clock) -> CameraSpec:
    base = drive.cameras.get(obj.uid)
    assert obj.camera is not None  # an object of kind CAMERA has a camera
    same_model = base is not None and obj.camera == base.model
    members = {} if same_model else camera_members(obj.camera, None if base is None else base.model)
    return _spec(CameraSpec, obj, base, members, optical(obj.poses), world_from_ego, drive, clock)


def _lidar(obj: SampledObject, world_from_ego: FloatArray, drive: Drive, clock: Clock) -> LidarSpec:
    base, model = drive.lidars.get(obj.uid), lidar_model(obj.model)
    same_model = base is not None and lidar_json(model) == lidar_json(base.model)
    members = {} if same_model else lidar_members(model)
    return _spec(LidarSpec, obj, base, members, obj.poses, world_from_ego, drive, clock)


def _spec(
    kind: type[Spec], obj: SampledObject, base: Camera | Lidar | None, members: dict[str, Any], world: FloatArray,
    world_from_ego: FloatArray, drive: Drive, clock: Clock,
) -> Spec:  # fmt: skip
    """A sensor's entry: what is another one than the ``base``'s, or all of a new one. ``world`` (N, 4, 4) are its poses."""
    late, name = lag(base, drive, clock), sensor_id(obj, drive)
    now = late @ invert_pose(world_from_ego) @ world
    if base is None:
        return kind(name, **members, **_mount(now, world, clock))
    mount = late @ recorded_mount(base, drive, clock)
    place = {} if same(now, mount).all() else _moved(now, mount, world, clock.of_sensor(base))
    return kind(name, None if name == obj.uid else obj.uid, **members, **place)


def _moved(now: FloatArray, mount: FloatArray, world: FloatArray, clock: Clock) -> dict[str, Any]:
    """A sensor of the log in another place on the vehicle, or on a trajectory of its own."""
    apart = (now - mount)[:, :3, 3]
    turned = now[:, :3, :3] @ np.swapaxes(mount[:, :3, :3], -1, -2)
    turns = np.tile(np.eye(4), (len(now), 1, 1))
    turns[:, :3, :3] = turned
    rigid = not (np.ptp(apart, axis=0) > 2 * SAME_M).any() and same_turn(turns, turns[:1]).all()
    # where training has a mount waver, one that is displaced wavers with it
    displaced = invert_pose(mount) @ now
    if not rigid and not same(displaced, displaced[:1]).all():
        return {"trajectory": free_trajectory(clock, world)}
    unmoved = bool(same_place(now, mount).all())
    unturned = bool(same_turn(now, mount).all())
    return {
        "mount_offset": Offset(
            position=None if unmoved else vector(apart.mean(0)),
            quaternion_wxyz=None if unturned else quaternion(quaternion_from_matrix(turned[len(turned) // 2])),
        )
    }


def _mount(now: FloatArray, world: FloatArray, clock: Clock) -> dict[str, Any]:
    """A new sensor's place on the vehicle, or a trajectory of its own."""
    if same(now, now[:1]).all():
        return {"mount": placement(now[0])}
    return {"trajectory": free_trajectory(clock, world)}


def free_trajectory(clock: Clock, world: FloatArray) -> tuple[Keyframe, ...]:
    """Keys of a sensor that does not ride on the vehicle: poses (N, 4, 4) at the clock's times. One that
    stands still has one."""
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


def sensor_words(named: str, spec: CameraSpec | LidarSpec) -> str:
    """Return what of a recorded sensor is another one."""
    words: list[str] = []
    if spec.trajectory is not None:
        words.append(Text("on a trajectory of its own"))
    if spec.mount_offset is not None:
        words.append(offset_words(spec.mount_offset))
    if isinstance(spec, CameraSpec) and (spec.width or spec.fx or spec.lens):
        words.append(Text("another lens"))
    if isinstance(spec, LidarSpec) and spec.elevation_deg is not None:
        words.append(Text("other beams"))
    return series([named, series(words)], ": ")


def offset_words(offset: Offset) -> str:
    """Return how far a sensor's mount is displaced along the vehicle's axes, and whether it is turned."""
    apart = np.eye(4)
    apart[:3, 3] = offset.position or (0.0, 0.0, 0.0)
    words: list[str] = [moved_words(apart)] if offset.position else []
    if offset.quaternion_wxyz is not None:
        angle = float(np.degrees(2 * np.arccos(np.clip(abs(offset.quaternion_wxyz[0]), 0, 1))))
        words.append(Text("turned by {angle}", angle=degrees(angle)))
    return series(words)
