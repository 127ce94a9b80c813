"""Limits of plausible motion, and whether the speed graph and the gizmos are shown: what a scene keeps of them."""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, FloatProperty, PointerProperty

from ...bridge.objects.imported import drive_of
from ...bridge.views.trails import compared_now
from ...editing.motion.kinematics import QUANTITIES, Limits, MotionComparison
from ...editing.sampled.clock import Clock

DEFAULT = Limits()


class UniSimMotion(bpy.types.PropertyGroup):
    """Limits of plausible motion, and what of it is shown."""

    acceleration_m_s2: FloatProperty(
        name="Acceleration",
        description="Largest plausible longitudinal acceleration of a vehicle, speeding up or braking; brakes of passenger cars "
        "have to give 6.43 m/s² (UN Regulation 13-H)",
        default=DEFAULT.acceleration_m_s2,
        min=0.1,
        soft_max=12.0,
        unit="ACCELERATION",
    )
    lateral_m_s2: FloatProperty(
        name="Lateral",
        description="Largest plausible lateral acceleration of a vehicle; ordinary driving stays below about 0.4 g",
        default=DEFAULT.lateral_m_s2,
        min=0.1,
        soft_max=12.0,
        unit="ACCELERATION",
    )
    curvature_1_m: FloatProperty(
        name="Curvature (1/m)",
        description="Largest plausible curvature of a vehicle's path; 0.2 1/m is a radius of 5 m, about the smallest that a "
        "small car can drive",
        default=DEFAULT.curvature_1_m,
        min=0.001,
        soft_max=1.0,
        precision=3,
    )
    show_graph: BoolProperty(
        name="Speed Graph",
        description="Draw the speed of the active actor, or of the ego vehicle, over the drive's seconds into the view's corner: "
        "recorded grey, edited blue, red where a limit is exceeded",
    )
    show_gizmos: BoolProperty(
        name="Edit Handles",
        description="Handles for the ego vehicle's lane, the active actor's trajectory and the active sensor's direction",
        default=True,
    )
    gizmos_in_cameras: BoolProperty(
        name="In Recorded Views",
        description="Show UniSim's handles also in a view through a camera of the drive, where they lie over the image",
    )


def limits_of(scene: bpy.types.Scene) -> Limits:
    """Return the limits that a scene has; one whose property was never changed has the default exactly."""
    motion = scene.unisim_motion
    return Limits(
        *(getattr(motion, name) if motion.is_property_set(name) else getattr(DEFAULT, name) for name in QUANTITIES)
    )


def graph_of(context: bpy.types.Context) -> MotionComparison | None:
    """Return the motion of the active actor or ego vehicle beside the recorded one; None where
    something else is active."""
    obj = context.active_object
    if obj is None or obj.unisim.kind not in ("ACTOR", "EGO") or obj.name not in context.scene.objects:
        return None
    drive = drive_of(context.scene)
    return None if drive is None else compared_now(obj, drive, Clock.of(drive), limits_of(context.scene))


PROPERTIES = ((bpy.types.Scene, "unisim_motion", PointerProperty(type=UniSimMotion)),)
