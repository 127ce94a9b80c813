"""A scenario's edits carried out on an imported scene's objects: the other direction of `reading`."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ..core.geometry import invert_pose
from ..core.meshes.read import read_mesh
from ..core.scenario.edits.context import pose_of
from ..core.scenario.edits.ego_body import LABEL
from ..core.scenario.types import CameraSpec, CopyStatic, EgoBody, FrameRange, LidarSpec, RemoveStatic, Scenario
from ..core.world.drive import Actor, Camera, Drive, Lidar
from .cameras import set_model
from .clock import Clock
from .ego_bodies import mount_body
from .importing import animate, go, ride_on_vehicle
from .mesh_objects import object_of
from .poses import optical
from .rig import lag, lidar_json, sensor_times
from .source import Source
from .standing import note_scale
from .static_items import mark
from .things import box_mesh, collection_of, make, new_actor, things
from .trajectories import remove


def apply_edits(scene: bpy.types.Scene, source: Source, scenario: Scenario, edited: Drive) -> None:
    """Make a freshly imported scene stand for ``scenario``, whose edits lead to the drive ``edited``."""
    clock = Clock.of(source.drive)
    _actors(scene, source.drive, edited, clock)
    _static(scene, scenario)
    ego = next(things(scene, "EGO"))
    _bodies(scene, ego, scenario)
    if edited.world_from_ego is not source.drive.world_from_ego:
        animate(ego, edited.world_from_ego, clock)
    _sensors(scene, ego, scenario, source.drive, edited, clock)
    frames = scenario.frames
    if isinstance(frames, FrameRange):
        scene.frame_start, scene.frame_end = edited.frames[0], edited.frames[-1]
        scene.frame_step = frames.step or 1
    elif frames:
        scene.frame_start, scene.frame_end = min(frames), max(frames)
    outputs = scenario.outputs
    if outputs is not None:
        scene.unisim.passes = set(outputs.passes or ()) - {"rgb"}
        scene.unisim.quality = outputs.quality or "balanced"
        scene.unisim.contact_shadows = bool(outputs.contact_shadows)


def _actors(scene: bpy.types.Scene, recorded: Drive, edited: Drive, clock: Clock) -> None:
    own = {thing.unisim.uid: thing for thing in things(scene, "ACTOR") if thing.name == thing.unisim.home}
    for uid, actor in recorded.actors.items():
        now = edited.actors.get(uid)
        if now is None:
            remove(own[uid])
        elif now is not actor:
            _look(own[uid], now, actor.look.actor)
            own[uid].scale = now.scale
            go(own[uid], now, edited, clock)
            note_scale(own[uid], _risen(now, actor))
    for uid, actor in edited.actors.items():
        if uid not in recorded.actors and not actor.is_ego_body:
            mesh = actor.look.mesh
            thing = object_of(uid, read_mesh(Path(mesh)), actor.label) if mesh else new_actor(uid, actor)
            collection_of(scene, "ACTOR").objects.link(thing)
            if not mesh:
                _look(thing, actor, actor.look.actor if not actor.look.scene else "")
            thing.scale = actor.scale
            go(thing, actor, edited, clock)
            source = recorded.actors.get(actor.look.actor) if not mesh and not actor.look.scene else None
            note_scale(thing, _risen(actor, source) if source is not None else 0.0)


def _risen(now: Actor, before: Actor) -> float:
    """Return how much higher an actor stands than one was recorded, in metres along its own axis, but for another appearance."""
    time_s = before.world_from_actor.times_s[0]
    pose, recorded = now.world_from_actor.at(time_s), before.world_from_actor.at(time_s)
    higher = float((pose[:3, 3] - recorded[:3, 3]) @ recorded[:3, 2])
    return higher - float(now.look_size_m[2] - before.size_m[2]) / 2


def _bodies(scene: bpy.types.Scene, ego: bpy.types.Object, scenario: Scenario) -> None:
    for edit in scenario.edits:
        if isinstance(edit, EgoBody):
            thing = object_of(edit.id, read_mesh(scenario.resolve(edit.mesh)), edit.label or LABEL)
            collection_of(scene, "BODY").objects.link(thing)
            mount_body(thing, ego, pose_of(edit.mount), edit.label or LABEL)


def _look(thing: bpy.types.Object, actor: Actor, natural: str) -> None:
    """Note a look that is not the object's own, and give the object that look's box."""
    if (actor.look.actor, actor.look.scene) == (natural, ""):
        return
    thing.unisim.look, thing.unisim.look_scene = actor.look.actor, actor.look.scene
    thing.data = box_mesh(actor.look_size_m, actor.label)


def _static(scene: bpy.types.Scene, scenario: Scenario) -> None:
    gone = {edit.box for edit in scenario.edits if isinstance(edit, RemoveStatic)}
    for uid, spec in (scenario.boxes or {}).items():
        thing = mark(scene, pose_of(spec), np.array(spec.size_m), uid)
        for edit in scenario.edits:
            if isinstance(edit, CopyStatic) and edit.box == uid:
                copy = thing.copy()
                copy.name = edit.id
                collection_of(scene, "STATIC").objects.link(copy)
                copy.location, copy.rotation_quaternion, _ = Matrix(pose_of(edit.target).tolist()).decompose()
        if uid in gone:
            bpy.data.objects.remove(thing)


def _sensors(
    scene: bpy.types.Scene, ego: bpy.types.Object, scenario: Scenario, recorded: Drive, edited: Drive, clock: Clock
) -> None:
    if scenario.sensors is None:
        return
    there: dict[str, Camera | Lidar] = {**edited.cameras, **edited.lidars}
    for thing in list(things(scene, "CAMERA", "LIDAR")):
        if thing.unisim.uid not in there:
            remove(thing)
    specs: list[CameraSpec | LidarSpec] = [*(scenario.sensors.cameras or ()), *(scenario.sensors.lidars or ())]
    free = {spec.id for spec in specs if spec.trajectory is not None}
    told = {spec.id: "ALWAYS" if spec.sees_ego_body else "NEVER" for spec in specs if spec.sees_ego_body is not None}
    for name, sensor in there.items():
        kind = "CAMERA" if isinstance(sensor, Camera) else "LIDAR"
        data = bpy.data.cameras.new(name) if kind == "CAMERA" and not _known(scene, name) else None
        thing = _known(scene, name) or make(scene, kind, name, name, data)
        thing.unisim.sees_ego_body = told.get(name, "AUTO")
        times = sensor_times(clock, sensor.time_s)
        if isinstance(sensor, Camera):
            set_model(thing, sensor.model)
            world = optical(sensor.world_from_camera.at(times))
        else:
            thing.unisim.model = lidar_json(sensor.model)
            world = sensor.world_from_lidar.at(times)
        if name in free:
            ride_on_vehicle(thing, world, np.tile(np.eye(4), (len(world), 1, 1)), None, clock)
        else:
            # where it is mounted, put where the recorded vehicle's motion has it at the frames
            mount, late = invert_pose(edited.world_from_ego.at(times)) @ world, lag(sensor, recorded, clock)
            ride_on_vehicle(thing, invert_pose(late) @ mount, late, ego, clock)


def _known(scene: bpy.types.Scene, name: str) -> bpy.types.Object | None:
    return next((thing for thing in things(scene, "CAMERA", "LIDAR") if thing.unisim.uid == name), None)
