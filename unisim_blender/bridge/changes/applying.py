"""A scenario's edits carried out on the objects of an imported scene, by their kinds: the other direction of readers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...core.geometry import invert_pose
from ...core.meshes.read import read_mesh
from ...core.scenario.edits import CopyStatic, Lamp, RemoveStatic, Row
from ...core.scenario.edits.ego_body import DEFAULT_LABEL, EgoBody
from ...core.scenario.motion.placement import pose_of
from ...core.scenario.sensors.document import CameraSpec, LidarSpec
from ...core.scenario.types import FRAME_FORMATS, FrameRange, Scenario
from ...core.sensors.frames import FILLS
from ...core.world.drive import Actor, Camera, Drive, Lidar
from ...editing.edits.maneuvers import ManeuverNote
from ...editing.reading.scenario import names_captures, span_s, stated_text
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import optical
from ...editing.sampled.source import DriveSource
from ...editing.sensors.mounts import lag, lidar_json
from ..importing.drive import animate, ride_on_vehicle
from ..objects.ego_bodies import mount_body
from ..objects.imported import collection_of, entitle, imported_objects, make, mark_static, new_actor, stand_at
from ..objects.lamps import apply_lamps
from ..objects.meshes import object_of
from ..objects.sensors import set_model
from ..objects.settings import apply_simulation
from ..objects.trajectories import remove
from ..objects.weather import apply_light, apply_weather
from . import carriers  # noqa: F401 so that all are registered
from .carriers.carrier import CARRIERS, Edited
from .carriers.scale import note_scale
from .rows import row_text


@dataclass(frozen=True)
class Target:
    """A freshly imported scene, its drive, and the drive that the scenario's edits lead to."""

    scene: bpy.types.Scene
    recorded: Drive
    scenario: Scenario
    edited: Drive
    clock: Clock

    @property
    def ego(self) -> bpy.types.Object:
        """The vehicle's object."""
        return next(imported_objects(self.scene, "EGO"))


def apply_edits(scene: bpy.types.Scene, source: DriveSource, scenario: Scenario, edited: Drive) -> Iterator[None]:
    """Make a freshly imported scene stand for ``scenario``, whose edits lead to the drive ``edited``, a step of some
    milliseconds at a time."""
    target = Target(scene, source.drive, scenario, edited, Clock.of(source.drive))
    yield from apply_actors(target)
    for apply in (apply_static, apply_bodies, apply_ego, apply_sensors):  # sensors are put where the edited vehicle is
        apply(target)
        yield
    _apply_settings(target)


def _apply_settings(target: Target) -> None:
    """Give the scene the scenario's frames and outputs, and let it keep what no object stands for."""
    scene, frames, outputs = target.scene, target.scenario.frames, target.scenario.outputs
    if isinstance(frames, FrameRange):
        scene.frame_start, scene.frame_end = target.edited.frames[0], target.edited.frames[-1]
        scene.frame_step = frames.step or 1
    elif frames:
        scene.frame_start, scene.frame_end = min(frames), max(frames)
    elif (span := span_s(target.scenario, target.edited)) is not None:
        first, last = target.clock.frame(np.array(span))
        scene.frame_start, scene.frame_end = max(0, math.floor(first)), math.ceil(last)
    scene.unisim.stated = stated_text(target.scenario)
    apply_simulation(scene, target.scenario.simulation)
    apply_weather(scene, target.scenario.weather, target.clock)
    apply_light(scene, target.scenario.light, target.clock)
    apply_lamps(scene, (edit for edit in target.scenario.edits if isinstance(edit, Lamp)), target.clock)
    if names_captures(scene.unisim.stated):
        scene.unisim.stated_range = (scene.frame_start, scene.frame_end, scene.frame_step)
    if outputs is not None:
        scene.unisim.passes = set(outputs.passes or ()) - {"rgb"}
        scene.unisim.formats = set(outputs.formats or FRAME_FORMATS)
        scene.unisim.quality = outputs.quality or "balanced"
        scene.unisim.contact_shadows = bool(outputs.contact_shadows)
        scene.unisim.fill_ground = outputs.fill not in (None, "none")
        scene.unisim.fixer = "" if outputs.fill in (None, *FILLS) else outputs.fill
        scene.unisim.detail = bool(outputs.detail)


def apply_static(target: Target) -> None:
    """Mark the boxes, and copy and remove what stands in them."""
    scene, scenario = target.scene, target.scenario
    gone = {edit.box for edit in scenario.edits if isinstance(edit, RemoveStatic)}
    for uid, spec in (scenario.boxes or {}).items():
        obj = mark_static(scene, pose_of(spec), np.array(spec.size_m), uid)
        for edit in scenario.edits:
            if isinstance(edit, CopyStatic) and edit.box == uid:
                copy = obj.copy()
                copy.name = edit.id
                entitle(copy, edit.id)
                collection_of(scene, "STATIC").objects.link(copy)
                stand_at(copy, pose_of(edit.target))
        if uid in gone:
            bpy.data.objects.remove(obj)


def apply_bodies(target: Target) -> None:
    """Make the bodies and mount them."""
    for edit in target.scenario.edits:
        if isinstance(edit, EgoBody):
            obj = object_of(edit.id, read_mesh(target.scenario.resolve(edit.mesh)), edit.label or DEFAULT_LABEL)
            entitle(obj, edit.id)
            collection_of(target.scene, "BODY").objects.link(obj)
            mount_body(obj, target.ego, pose_of(edit.mount), edit.label or DEFAULT_LABEL)


def apply_ego(target: Target) -> None:
    """Let the vehicle drive elsewhere."""
    if target.edited.world_from_ego is not target.recorded.world_from_ego:
        animate(target.ego, target.edited.world_from_ego, target.clock)


def apply_actors(target: Target) -> Iterator[None]:
    """Remove and change objects of recorded actors, and make those of new ones, an actor at a time."""
    scene, recorded, edited = target.scene, target.recorded, target.edited
    own = {obj.unisim.uid: obj for obj in imported_objects(scene, "ACTOR") if obj.name == obj.unisim.home}
    for uid, actor in recorded.actors.items():
        now = edited.actors.get(uid)
        if now is None:
            remove(own[uid])
        elif now is not actor:
            _apply(target, own[uid], now, actor.appearance.actor)
            note_scale(own[uid], _risen(now, actor))
            yield
    for uid, actor in edited.actors.items():
        if uid not in recorded.actors and not actor.is_ego_body:
            mesh = actor.appearance.mesh
            obj = object_of(uid, read_mesh(Path(mesh)), actor.label) if mesh else new_actor(uid, actor)
            rows = (edit for edit in target.scenario.edits if isinstance(edit, Row))
            obj.unisim.row = next((row_text(row) for row in rows if uid.rpartition(" ")[0] == row.id), "")
            entitle(obj, uid)
            collection_of(scene, "ACTOR").objects.link(obj)
            _apply(target, obj, actor, None if mesh else actor.appearance.actor if not actor.appearance.scene else "")
            source = None if mesh or actor.appearance.scene else recorded.actors.get(actor.appearance.actor)
            note_scale(obj, _risen(actor, source) if source is not None else 0.0)
            yield


def _risen(now: Actor, before: Actor) -> float:
    """Return how much higher an actor stands than one was recorded, in metres along its own axis, but for
    another appearance."""
    time_s = before.world_from_actor.times_s[0]
    pose, recorded = now.world_from_actor.at(time_s), before.world_from_actor.at(time_s)
    higher = float((pose[:3, 3] - recorded[:3, 3]) @ recorded[:3, 2])
    return higher - float(now.appearance_size_m[2] - before.size_m[2]) / 2


def _apply(target: Target, obj: bpy.types.Object, actor: Actor, own_appearance: str | None) -> None:
    for carrier in CARRIERS.values():
        carrier.apply(obj, Edited(actor, target.edited, own_appearance, target.clock))
    obj.unisim.maneuvers = str(ManeuverNote.of_edits(target.scenario.edits, actor.uid) or "")


def apply_sensors(target: Target) -> None:
    """Remove sensors that are gone, and make or change the others."""
    scene, scenario, edited, clock = target.scene, target.scenario, target.edited, target.clock
    if scenario.sensors is None:
        return
    there: dict[str, Camera | Lidar] = {**edited.cameras, **edited.lidars}
    for obj in list(imported_objects(scene, "CAMERA", "LIDAR")):
        if obj.unisim.uid not in there:
            remove(obj)
    specs: list[CameraSpec | LidarSpec] = [*(scenario.sensors.cameras or ()), *(scenario.sensors.lidars or ())]
    free = {spec.id for spec in specs if spec.trajectory is not None}
    # a recorded sensor that stays on its mount rides on the vehicle as it was imported, wherever that drives
    moved = {spec.id for spec in specs if spec.mount or spec.mount_offset or spec.trajectory or spec.like}
    unmoved = {*target.recorded.cameras, *target.recorded.lidars} - moved
    sees_body = {
        spec.id: "ALWAYS" if spec.sees_ego_body else "NEVER" for spec in specs if spec.sees_ego_body is not None
    }
    for name, sensor in there.items():
        kind = "CAMERA" if isinstance(sensor, Camera) else "LIDAR"
        data = bpy.data.cameras.new(name) if kind == "CAMERA" and not _known(scene, name) else None
        obj = _known(scene, name) or make(scene, kind, name, name, data)
        obj.unisim.sees_ego_body = sees_body.get(name, "AUTO")
        times = clock.of_sensor(sensor).times_s
        world = sensor.trajectory.at(times)
        if isinstance(sensor, Camera):
            world = optical(world)
            set_model(obj, sensor.model)
        else:
            obj.unisim.model = lidar_json(sensor.model)
        if name in unmoved and data is None:
            continue
        if name in free:
            ride_on_vehicle(obj, world, np.tile(np.eye(4), (len(world), 1, 1)), None, clock)
        else:
            # where it is mounted, put where the recorded vehicle's motion has it at the frames
            mount, late = invert_pose(edited.world_from_ego.at(times)) @ world, lag(sensor, target.recorded, clock)
            ride_on_vehicle(obj, invert_pose(late) @ mount, late, target.ego, clock)


def _known(scene: bpy.types.Scene, name: str) -> bpy.types.Object | None:
    return next((obj for obj in imported_objects(scene, "CAMERA", "LIDAR") if obj.unisim.uid == name), None)
