"""Objects' poses at every frame of the drive, from their keys and those of their parents, without stepping through the
frames, so that a window goes on in between.

Objects that anything else moves (a constraint, a driver, the NLA) are evaluated in a scene beside, as `adjacent_frames`
does it. `Sampler.signature` tells whether an object is the same as when it was read last. `stepping.sample_all` evaluates
the scene at every frame instead: it is the plain reference, and what runs without a window."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import replace

import bpy
import numpy as np
from mathutils import Quaternion

from ...core.geometry import BoolArray, FloatArray
from ...editing.motion.keys import SAME
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import Sampled, SampledObject, Scaling, rigid, scaling_of
from ..objects.animation import curves_of, keyed_values
from ..objects.imported import KINDS_OF_DRIVE, imported_objects, skipped_sensors, title_of, with_parents
from ..objects.lamps import lamp_settings
from ..objects.trajectories import local_poses, trajectory_of
from ..objects.weather import scene_light, scene_weather
from .adjacent_frames import evaluate_beside, moved_by_keys
from .stepping import completed, depsgraph_of, described, image_size, refuse_stretching, shown_names, static_items

HIDING = ("hide_viewport", "hide_render")
OBJECT_PROPERTIES = ("name", "type", "parent_type", "rotation_mode", "hide_render", "hide_viewport", "pass_index")
OWN_PROPERTIES = (
    "kind",
    "uid",
    "home",
    "look",
    "look_scene",
    "mesh",
    "label",
    "model",
    "called",
    "called_as",
    "scale_lift_m",
    "row",
    "maneuvers",
)
KEYABLE_PROPERTIES = ("location", "rotation_quaternion", "rotation_euler", "scale")
DELTA_PROPERTIES = ("delta_location", "delta_rotation_euler", "delta_rotation_quaternion", "delta_scale")
LENS_PROPERTIES = ("lens", "sensor_width", "sensor_height", "shift_x", "shift_y", "sensor_fit")

FRAMES_AT_ONCE = 4
"""Frames that are evaluated beside in one step."""
StepsDone = tuple[int, int]
"""Steps that are done, and all steps."""


class Sampler:
    """Samples objects of one scene at the frames of ``clock``. ``shown`` are the names of objects in rendered
    collections; ``live``: whether changes without a key are read, too, by default where the scene is in a window."""

    def __init__(self, scene: bpy.types.Scene, clock: Clock, shown: set[str], live: bool | None = None) -> None:
        self.scene, self.clock, self.shown = scene, clock, shown
        windows = bpy.context.window_manager.windows
        self.live = any(window.scene == scene for window in windows) if live is None else live
        self._matrices: dict[str, FloatArray] = {}
        self._signatures: dict[str, tuple[object, ...]] = {}

    def sample(
        self, obj: bpy.types.Object, matrices: FloatArray | None = None, there: BoolArray | None = None
    ) -> SampledObject:
        """Return an object at all frames; ``matrices`` (N, 4, 4) and ``there`` (N,) are given where keys do not tell
        them."""
        if matrices is None or there is None:
            matrices, there = self.matrices(obj), self.there(obj)
        about, above = obj.unisim, trajectory_of(obj)
        poses = rigid(matrices)
        scaling = Scaling() if about.mesh else scaling_of(matrices, poses, there)
        sampled = described(obj, poses, there & (obj.name in self.shown), scaling, image_size(self.scene.render))
        return replace(
            sampled,
            mesh=title_of(obj) if about.mesh else "",
            ridden=rigid(self.matrices(above)) if above is not None and moved_by_keys(above) else None,
            scale_lift_m=about.scale_lift_m,
        )

    def matrices(self, obj: bpy.types.Object) -> FloatArray:
        """Return where keys put an object in the world (N, 4, 4), with its scale."""
        if obj.name not in self._matrices:
            own = self._local(obj)
            if obj.parent is not None:
                own = self.matrices(obj.parent) @ np.array(obj.matrix_parent_inverse, float) @ own
            self._matrices[obj.name] = own
        return self._matrices[obj.name]

    def there(self, obj: bpy.types.Object) -> BoolArray:
        """Return whether keys and switches show an object (N,), whatever its collections do."""
        keyed = {curve.data_path: self._values(curve) > 0.5 for curve in curves_of(obj) if curve.data_path in HIDING}
        for_renders = np.full(len(self.clock.frames), obj.hide_render)
        return ~(keyed.get("hide_render", for_renders) | keyed.get("hide_viewport", np.zeros_like(for_renders)))

    def signature(self, obj: bpy.types.Object) -> tuple[object, ...]:
        """Return what an object's samples depend on, parents included; what moves it beside keys is not part of it."""
        if obj.name not in self._signatures:
            keyed = {curve.data_path for curve in curves_of(obj)}
            numbers = [tuple(getattr(obj, path)) for path in KEYABLE_PROPERTIES if path not in keyed]
            numbers += [tuple(getattr(obj, path)) for path in DELTA_PROPERTIES]
            own = (
                *(getattr(obj, name) for name in OBJECT_PROPERTIES if name != "hide_viewport" or name not in keyed),
                *(getattr(obj.unisim, name) for name in OWN_PROPERTIES),
                *numbers,
                tuple(tuple(row) for row in obj.matrix_parent_inverse),
                tuple(_curve_state(curve) for curve in curves_of(obj)),
                tuple(self._pending(obj).ravel().round(6).tolist()),
                obj.name in self.shown,
                moved_by_keys(obj),
                tuple(getattr(obj.data, name) for name in LENS_PROPERTIES if obj.type == "CAMERA"),
            )
            self._signatures[obj.name] = own if obj.parent is None else (*own, hash(self.signature(obj.parent)))
        return self._signatures[obj.name]

    def _local(self, obj: bpy.types.Object) -> FloatArray:
        """Return an object's own transform (N, 4, 4) by its keys."""
        whole, pending = local_poses(obj, self.clock.frames), self._pending(obj)
        whole[:, :3, :3] = pending[:3, :3] @ whole[:, :3, :3] * keyed_values(obj, "scale", self.clock.frames)[:, None]
        whole[:, :3, 3] += pending[:3, 3]
        return whole

    def _pending(self, obj: bpy.types.Object) -> FloatArray:
        """Return the change (4, 4) of an object that has keys which was made without a key: the next frame displaces
        its keys by it (`following.keep`), in its parent's axes."""
        apart = np.eye(4)
        if (
            not len(curves_of(obj))
            or not self.live
            or trajectory_of(obj) is None
            or not obj.visible_get(view_layer=self.scene.view_layers[0])
        ):
            return apart
        frames = [self.scene.frame_current_final]
        now, keyed = np.array(obj.location, float), keyed_values(obj, "location", frames)[0]
        if np.abs(now - keyed).max() > SAME * max(1.0, float(np.abs(keyed).max())):
            apart[:3, 3] = now - keyed
        turn, keyed = np.array(obj.rotation_quaternion, float), keyed_values(obj, "rotation_quaternion", frames)[0]
        if np.abs(turn - keyed).max() > SAME:
            turned = Quaternion(turn).normalized() @ Quaternion(keyed).normalized().inverted()
            apart[:3, :3] = np.array(turned.to_matrix(), float)
        return apart

    def _values(self, curve: bpy.types.FCurve) -> FloatArray:
        evaluate = curve.evaluate
        return np.array([evaluate(frame) for frame in self.clock.frames.tolist()])


def evaluated(
    frames: FloatArray, moved: Sequence[bpy.types.Object], announce: Callable[[], None] = lambda: None
) -> Generator[None, None, dict[str, tuple[FloatArray, BoolArray]]]:
    """Return, after some steps, by their names where objects are in the world at frames (N,), as (N, 4, 4), and whether
    they are shown (N,). They are evaluated in a scene beside; ``announce`` is called before each is made.

    Not to be stepped while anything is drawn or rendered.
    """
    parts = []
    for at in range(0, len(frames), FRAMES_AT_ONCE) if moved else ():
        announce()
        parts.append(evaluate_beside(frames[at : at + FRAMES_AT_ONCE].tolist(), moved))
        yield
    if not parts:
        return {}
    matrices, hidden, left_out = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return {obj.name: (matrices[:, i], ~(hidden | left_out)[:, i]) for i, obj in enumerate(moved)}


def _curve_state(curve: bpy.types.FCurve) -> tuple[object, ...]:
    points = curve.keyframe_points
    values = np.empty(2 * len(points), np.float32)
    parts = []
    for name in ("co", "handle_left", "handle_right"):
        points.foreach_get(name, values)
        parts.append(values.tobytes())
    interpolations = np.empty(len(points), np.int32)
    points.foreach_get("interpolation", interpolations)
    state = curve.data_path, curve.array_index, curve.extrapolation, curve.mute, len(curve.modifiers)
    return (*state, hash((*parts, interpolations.tobytes())))


def sample_steps(scene: bpy.types.Scene, clock: Clock) -> Generator[StepsDone, None, Sampled]:
    """Return, after some steps, the scene's objects at all of the clock's frames.

    The scene must not change between steps. Raises `UnisimError` where it cannot be read.
    """
    refuse_stretching(scene)
    objects = list(imported_objects(scene, *KINDS_OF_DRIVE))
    free = [obj for obj in objects if not by_keys_alone(obj)]
    evaluation = evaluated(clock.frames, free)
    done, total = 0, (-(-len(clock.frames) // FRAMES_AT_ONCE) if free else 0) + len(objects)
    while True:
        try:
            next(evaluation)
        except StopIteration as end:
            beside = end.value
            break
        yield (done := done + 1), total
    shown = scene == bpy.context.scene
    layer = bpy.context.view_layer if shown else scene.view_layers[0]
    sampler = Sampler(scene, clock, shown_names(layer.layer_collection))
    sampled = []
    for obj in objects:
        sampled.append(completed(sampler.sample(obj, *beside.get(obj.name, ())), obj, lambda: depsgraph_of(scene)))
        yield (done := done + 1), total
    items, weather, light = static_items(scene), scene_weather(scene), scene_light(scene)
    return Sampled(
        scene.name, clock, tuple(sampled), items, skipped_sensors(scene), weather, light, lamp_settings(scene)
    )


def by_keys_alone(obj: bpy.types.Object) -> bool:
    """Return whether `Sampler` finds an object where Blender evaluates it: no deltas of the scale, no muted curves, and
    no parent whose path moves what is parented to it."""
    for above in with_parents(obj):
        muted = any(curve.mute or (curve.group is not None and curve.group.mute) for curve in curves_of(above))
        deltas = any(curve.data_path.startswith("delta_") for curve in curves_of(above))
        if (
            muted
            or deltas
            or tuple(above.delta_scale) != (1.0, 1.0, 1.0)
            or (above is not obj and above.type == "CURVE")
        ):
            return False
    return moved_by_keys(obj)
