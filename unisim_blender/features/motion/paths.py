"""Actors on drawn curves and on the ground."""

import bpy
import numpy as np
from bpy.props import FloatProperty

from ...bridge.changes.motion import displaced_along, follow
from ...bridge.objects.meshes import size_of
from ...bridge.objects.source import source_of
from ...bridge.sampling.stepping import frame_of
from ...bridge.window.polling import allowed, object_mode, selected
from ...bridge.window.refresh import refresh
from ...bridge.window.selection import chosen, counted_names
from ...core.errors import UnisimError
from ...editing.motion.durations import followed, followed_briefly
from ...editing.motion.ground import ground_height
from ...editing.sampled.clock import Clock
from ...editing.texts import series
from ...translations import localized, message


class UNISIM_OT_follow_curve(bpy.types.Operator):
    """Move the selected actors along the selected curve at a constant speed, from the current frame on"""

    bl_idname = "unisim.follow_curve"
    bl_label = "Follow Curve"
    bl_options = {"REGISTER", "UNDO"}

    speed_m_s: FloatProperty(
        name="Speed", description="Speed along the curve", default=8.0, min=0.1, soft_max=40.0, unit="VELOCITY"
    )
    length_m: FloatProperty(
        name="Length", description="Length of the curve", unit="LENGTH", options={"HIDDEN", "SKIP_SAVE"}
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Actors and one curve have to be selected."""
        curves = [obj for obj in context.selected_objects if obj.type == "CURVE"]
        curve = len(curves) == 1, "Select one curve in addition to the actors (Add > Curve)"
        return allowed(cls, object_mode(context), selected(context, "Select an actor first", "ACTOR"), curve)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the speed, and how long the curve takes at it in seconds and frames."""
        self.layout.prop(self, "speed_m_s")
        try:
            clock = Clock.of(source_of(context.scene).drive)
        except (UnisimError, OSError):
            return
        start_s = float(clock.time_s(np.array(frame_of(context.scene))))
        for line in followed(self.length_m, self.speed_m_s, start_s, clock):
            self.layout.label(text=localized(line), translate=False)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Keys along the curve; the actors' undersides are on it."""
        curve = next(obj for obj in context.selected_objects if obj.type == "CURVE")
        evaluated = curve.evaluated_get(context.evaluated_depsgraph_get())
        mesh = evaluated.to_mesh()
        line = np.array([curve.matrix_world @ vertex.co for vertex in mesh.vertices], float)
        evaluated.to_mesh_clear()
        if len(line) < 2:
            self.report({"ERROR"}, message('curve "{name}" has fewer than two points', name=curve.name))
            return {"CANCELLED"}
        try:
            clock = Clock.of(source_of(context.scene).drive)
        except (UnisimError, OSError) as fault:
            self.report({"ERROR"}, str(fault))
            return {"CANCELLED"}
        actors = chosen(context, "ACTOR")
        for obj in actors:
            follow(obj, line, frame_of(context.scene), self.speed_m_s, clock)
        refresh(actors)
        self.length_m = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
        start_s = float(clock.time_s(np.array(frame_of(context.scene))))
        done = followed_briefly(self.length_m, self.speed_m_s, start_s, clock)
        self.report({"INFO"}, localized(series([counted_names(actors), done], ": ")))
        return {"FINISHED"}


class UNISIM_OT_snap_to_ground(bpy.types.Operator):
    """Place the selected actors and static items on the ground below them, at the current frame"""

    bl_idname = "unisim.snap_to_ground"
    bl_label = "Snap to Ground"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Something has to be selected."""
        needed = selected(context, "Select an actor or a static item first", "ACTOR", "STATIC")
        return allowed(cls, object_mode(context), needed)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Up or down along the box's own axis."""
        try:
            source = source_of(context.scene)
            for obj in chosen(context, "ACTOR", "STATIC"):
                now = np.array(obj.matrix_world, float)
                low = now[:3, 3] - now[:3, 2] / np.linalg.norm(now[:3, 2]) * float(size_of(obj)[2]) / 2
                ground = ground_height(source, low, context.scene.frame_current)
                if ground is None:
                    self.report({"WARNING"}, message("{name}: the ground height is unknown there", name=obj.name))
                else:
                    displaced_along(obj, (0.0, 0.0, ground - low[2]))
        except (UnisimError, OSError) as fault:
            self.report({"ERROR"}, str(fault))
            return {"CANCELLED"}
        refresh(chosen(context, "ACTOR", "STATIC"))
        return {"FINISHED"}


CLASSES = (UNISIM_OT_follow_curve, UNISIM_OT_snap_to_ground)
