"""A drive into a Blender scene. What is there already is brought up to date, never doubled."""

from __future__ import annotations

import json
from collections.abc import Generator, Iterator
from typing import NamedTuple

import bpy

from ...core.data.log import extras_of
from ...core.errors import UnisimError
from ...core.geometry import FloatArray, Trajectory, invert_pose
from ...core.world.drive import Actor, Camera, Drive, Lidar
from ...editing.actors.table import names_at_import
from ...editing.layout.shapes import DISPLAY_M
from ...editing.reading.scenario import edited_ids
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import optical, same
from ...editing.sampled.source import DriveSource, ImportOptions
from ...editing.sensors.mounts import lag, lidar_json, recorded_mount
from ..objects.animation import write_presence, write_trajectory
from ..objects.imported import (
    as_imported,
    box_mesh,
    collection_of,
    has_drive,
    imported_objects,
    make,
    skip_sensors,
    skipped_sensors,
    source_of,
)
from ..objects.sensors import camera_model_of, set_model
from ..objects.trajectories import free, local_poses, remove, ride, set_on_trajectory, settle_on
from ..objects.weather import show_recorded_sun
from ..sampling.from_keys import sample_steps
from .backgrounds import set_background

EVERYTHING = ImportOptions()
ASIDE_COLLECTION = "Not in the drive"
"""The collection of what a new file of Blender's brings."""
DEFAULT_OBJECTS = {"Cube": (0.0, 0.0, 0.0), "Light": (4.0762, 1.0055, 5.9039), "Camera": (7.3589, -6.9258, 4.9583)}
"""Names and places of Blender's default objects."""


class ImportStep(NamedTuple):
    """Steps ``done``, steps in all, ``what`` is being done. ``draw``: whether the window is best drawn
    before the next one.

    Blender compiles shaders where it first draws a kind of object; so they are not all compiled in one redraw."""

    done: int
    total: int
    what: str
    draw: bool = False


def import_source(
    scene: bpy.types.Scene, source: DriveSource, options: ImportOptions = EVERYTHING
) -> Iterator[ImportStep]:
    """Put a source's drive into a scene, or the parts of it in ``options``. What is returned does it step by step: whoever
    runs it may stop, and say how far it is.

    Where the scene holds the drive already, what was edited stays as it is, and the rest is brought up to date. Raises
    `UnisimError` in the first step where it holds another drive, or where ``options`` do not fit the drive.
    """
    skipped, frames = options.of_drive(source.drive, skipped_sensors(scene))
    edited: set[str] = set()
    first = not has_drive(scene)
    if not first:
        edited = yield from _edited(scene, source)
    drive, about = source.drive, scene.unisim
    skipped -= edited
    actors = [drive.actors[uid] for uid in sorted(set(drive.actors) - edited)]
    cameras = [camera for name, camera in drive.cameras.items() if name not in edited | skipped]
    lidars = [lidar for name, lidar in drive.lidars.items() if name not in edited | skipped]
    total = 2 + len(cameras) + len(lidars) + len(actors)
    done = 0
    about.trajectories = True
    about.log, about.scene = str(source.log_path), str(source.scene_path or "")
    about.origin = json.dumps(drive.world_origin.tolist())
    clock, names = Clock.of(drive), names_at_import(source)
    set_time(scene, clock, frames or (None if first else (scene.frame_start, scene.frame_end, scene.frame_step)))
    for kind, uid in [(kind, uid) for kind in ("CAMERA", "LIDAR") for uid in skipped]:
        if (obj := as_imported(scene, kind, uid)) is not None:
            remove(obj)
    skip_sensors(scene, skipped)
    if first:
        scene.frame_set(scene.frame_start)
        for kind in ("EGO", "ACTOR", "CAMERA", "TRAJECTORY"):  # in the outliner, what people use comes first
            collection_of(scene, kind)
    set_colours(scene)
    yield ImportStep(done := done + 1, total, "time")
    ego = _ego(scene, drive, clock) if "ego" not in edited else next(imported_objects(scene, "EGO"))
    yield ImportStep(done := done + 1, total, "ego vehicle")
    for camera in cameras:
        _camera(scene, source, camera, ego, clock)
        yield ImportStep(done := done + 1, total, camera.sensor_id, draw=camera is cameras[-1])
    for lidar in lidars:
        _lidar(scene, drive, lidar, ego, clock)
        yield ImportStep(done := done + 1, total, lidar.sensor_id, draw=lidar is lidars[-1])
    for actor in actors:
        _actor(scene, drive, actor, clock, names[actor.uid])
        yield ImportStep(done := done + 1, total, actor.label)
    yield ImportStep(total, total, "actors", draw=True)
    if first:
        sun = None if source.log is None else extras_of(source.log).sun
        if sun is not None:
            show_recorded_sun(scene, sun)
        set_aside(scene)
        scene.render.engine = "UNISIM"
    if scene.camera is None or first:
        scene.camera = front_camera(scene) or scene.camera
        fit_resolution(scene)


def import_sensors(scene: bpy.types.Scene, source: DriveSource, names: set[str]) -> None:
    """Make objects of recorded sensors that were deleted, as the import makes them."""
    for kind, sensors in (("CAMERA", source.drive.cameras), ("LIDAR", source.drive.lidars)):
        for name in names & set(sensors):
            import_object(scene, source, kind, name)
    skip_sensors(scene, skipped_sensors(scene) - names)


def front_camera(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """Return the camera of the rig that looks furthest ahead along the vehicle; None where there is none."""
    cameras = [camera for camera in imported_objects(scene, "CAMERA") if not camera.hide_render]
    return max(cameras, key=lambda camera: -local_poses(camera, [scene.frame_current])[0, 0, 2], default=None)


def set_aside(scene: bpy.types.Scene) -> None:
    """Keep the objects that a new file of Blender's brings out of the view and of images; they stay in the file."""
    defaults = [obj for obj in scene.objects if obj.unisim.kind == "NONE" and is_default(obj)]
    if not defaults:
        return
    aside = bpy.data.collections.new(ASIDE_COLLECTION)
    scene.collection.children.link(aside)
    for obj in defaults:
        for collection in obj.users_collection:
            collection.objects.unlink(obj)
        aside.objects.link(obj)
    aside.hide_render = True
    for layer in scene.view_layers:
        layer.layer_collection.children[aside.name].exclude = True


def is_default(obj: bpy.types.Object) -> bool:
    """Return whether an object is one of those that a new file of Blender's has, as they were."""
    at = DEFAULT_OBJECTS.get(obj.name)
    plain = obj.parent is None and obj.animation_data is None and not obj.modifiers and not obj.constraints
    return at is not None and plain and all(abs(a - b) < 1e-3 for a, b in zip(obj.location, at, strict=True))


def _edited(scene: bpy.types.Scene, source: DriveSource) -> Generator[ImportStep, None, set[str]]:
    """Return, after some steps, what of the drive in a scene does not stand as it was imported, by id."""
    before = source_of(scene)
    if before.log_path != source.log_path:
        raise UnisimError(
            f'scene "{scene.name}": holds the drive {before.log_path} already; import {source.log_path} into a new scene'
        )
    steps = sample_steps(scene, Clock.of(before.drive))
    while True:
        try:
            done, total = next(steps)
        except StopIteration as end:
            return edited_ids(end.value, before.drive)
        yield ImportStep(done, 2 * total, "edits")


def fit_resolution(scene: bpy.types.Scene) -> None:
    """Make images as large as the active camera's, where that is one of the rig."""
    if scene.camera is None or scene.camera.unisim.kind != "CAMERA":
        return
    model = camera_model_of(scene.camera)
    render = scene.render
    render.resolution_x, render.resolution_y = model.width, model.height
    # Blender has one focal length: what fx and fy differ by is the pixel's shape
    # a lens that bends lines is shown by a frustum of square pixels
    ratio = model.fy / model.fx if model.is_pinhole else 1.0
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, ratio), max(1.0, 1 / ratio)


def set_time(scene: bpy.types.Scene, clock: Clock, frames: tuple[int, int, int] | None = None) -> None:
    """Frame n is the log's frame n, at the log's rate; ``frames`` are the first, the last and the step, all of them
    without."""
    rate = clock.rate
    whole = max(1, round(rate))
    scene.render.fps, scene.render.fps_base = whole, whole / rate
    every = int(clock.frames[0]), int(clock.frames[-1]), scene.frame_step
    scene.frame_start, scene.frame_end, scene.frame_step = frames or every
    scene.frame_set(min(max(scene.frame_current, scene.frame_start), scene.frame_end))


def set_colours(scene: bpy.types.Scene) -> None:
    """Images are shown as they were recorded."""
    view = scene.view_settings
    view.view_transform, view.look, view.exposure, view.gamma = "Standard", "None", 0.0, 1.0
    scene.render.dither_intensity = 0.0  # noise of one step of eight bits


def recorded_colours(scene: bpy.types.Scene) -> bool:
    """Whether images are shown as they were recorded."""
    view = scene.view_settings
    return view.view_transform == "Standard" and view.look == "None" and view.exposure == 0 and view.gamma == 1


def _ego(scene: bpy.types.Scene, drive: Drive, clock: Clock) -> bpy.types.Object:
    ego = make(scene, "EGO", "ego", "Ego vehicle", None)
    ego.empty_display_type, ego.empty_display_size = "ARROWS", 1.0
    animate(ego, drive.world_from_ego, clock)
    return ego


def ride_on_vehicle(
    obj: bpy.types.Object, mount: FloatArray, late: FloatArray, ego: bpy.types.Object | None, clock: Clock
) -> None:
    """Parent a sensor to the vehicle ``ego``, or to nothing.

    ``mount`` (N, 4, 4) are its poses in the parent's axes, in Blender's convention, at the clock's frames. A sensor
    looks a little earlier or later than the frame's time, so the vehicle's motion until then, whose inverse ``late``
    (N, 4, 4) is, moves its object on the vehicle; so do corrections that training makes. That is its trajectory. The
    object's own transform is its mount.
    """
    on_mount = (late @ mount)[0]
    if same(mount, mount[:1]).all():
        animate(obj, single_key(Trajectory.from_poses(clock.times_s, mount)), clock, on=ego)
        return
    animate(obj, Trajectory.from_poses(clock.times_s, mount @ invert_pose(on_mount)), clock, on=ego)
    set_on_trajectory(obj, on_mount)


def _camera(scene: bpy.types.Scene, source: DriveSource, camera: Camera, ego: bpy.types.Object, clock: Clock) -> None:
    name = camera.sensor_id
    standing = as_imported(scene, "CAMERA", name)
    data = standing.data if standing is not None else bpy.data.cameras.new(f"UniSim {name}")  # each variant has its own
    obj = make(scene, "CAMERA", name, name, data)
    set_model(obj, camera.model)
    data.display_size, data.clip_end = DISPLAY_M, 1000.0
    if source.log is not None:
        set_background(data, source.log, name)
    drive = source.drive
    ride_on_vehicle(obj, optical(recorded_mount(camera, drive, clock)), lag(camera, drive, clock), ego, clock)


def _lidar(scene: bpy.types.Scene, drive: Drive, lidar: Lidar, ego: bpy.types.Object, clock: Clock) -> None:
    obj = make(scene, "LIDAR", lidar.sensor_id, lidar.sensor_id, None)
    obj.empty_display_type, obj.empty_display_size = "CONE", DISPLAY_M
    obj.unisim.model = lidar_json(lidar.model)
    ride_on_vehicle(obj, recorded_mount(lidar, drive, clock), lag(lidar, drive, clock), ego, clock)


def _actor(scene: bpy.types.Scene, drive: Drive, actor: Actor, clock: Clock, name: str) -> None:
    obj = make(scene, "ACTOR", actor.uid, name, box_mesh(actor.size_m, actor.label))
    obj.show_wire, obj.color = True, (1.0, 1.0, 1.0, 1.0)
    obj.pass_index = 1 + sorted(drive.actors).index(actor.uid)
    go(obj, actor, drive, clock)


def import_object(scene: bpy.types.Scene, source: DriveSource, kind: str, uid: str) -> None:
    """Put one actor or sensor of the drive into a scene, or bring it up to date. Needs the ego vehicle."""
    drive, clock, ego = source.drive, Clock.of(source.drive), next(imported_objects(scene, "EGO"))
    if kind == "ACTOR":
        _actor(scene, drive, drive.actors[uid], clock, names_at_import(source)[uid])
    elif kind == "CAMERA":
        _camera(scene, source, drive.cameras[uid], ego, clock)
    else:
        _lidar(scene, drive, drive.lidars[uid], ego, clock)


def go(obj: bpy.types.Object, actor: Actor, drive: Drive, clock: Clock) -> None:
    """Let an object follow an actor's trajectory, present while the actor is."""
    trajectory = actor.world_from_actor
    animate(obj, trajectory if actor.is_moving else single_key(trajectory), clock, drive.window(actor))


def animate(
    obj: bpy.types.Object,
    trajectory: Trajectory,
    clock: Clock,
    present_s: tuple[float, float] | None = None,
    on: bpy.types.Object | None = None,
) -> None:
    """Put an object on a trajectory in the axes of ``on``, or in the world's; one key stands for a place,
    without a trajectory.

    Outside ``present_s`` the object is hidden in the view.
    """
    write_presence(obj, clock, present_s)
    obj.rotation_mode = "QUATERNION"
    if len(trajectory.times_s) > 1:
        write_trajectory(ride(obj, on), trajectory, clock)
        return
    free(obj, on)
    settle_on(obj)
    obj.location, obj.rotation_quaternion = trajectory.positions[0], trajectory.quaternions_wxyz[0]


def single_key(trajectory: Trajectory) -> Trajectory:
    """Standing still at a trajectory's first key."""
    return Trajectory(trajectory.times_s[:1], trajectory.positions[:1], trajectory.quaternions_wxyz[:1])
