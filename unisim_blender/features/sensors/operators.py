"""New cameras and LiDARs on the vehicle."""

from typing import Any

import bpy
import numpy as np
from bpy.props import EnumProperty, FloatProperty, FloatVectorProperty, IntProperty, StringProperty
from mathutils import Euler, Matrix

from ...bridge.importing.drive import fit_resolution
from ...bridge.importing.rig_presets import add_sensor, look_ahead, show_sensor
from ...bridge.objects.imported import drive_of, imported_objects
from ...bridge.window import choose, chosen, object_mode, refresh, selected, vehicle
from ...core.sensors.beam_tables import BEAM_TABLES
from ...core.world.drive import CameraModel, LidarModel
from ...editing.sensors.mounts import lidar_json, own_table
from ...translations import message
from ..operator_bases import Editing, Needing, reporting

OWN = "OWN"
OWN_TABLE = "15, 10, 5, 2, 0, -2, -4, -7, -10, -15"
PRESETS = [
    *((name, name.upper(), (table.__doc__ or "").rstrip(".")) for name, table in BEAM_TABLES.items()),
    (OWN, "Custom", "Custom elevation angles"),
]


def put_on_vehicle(
    context: bpy.types.Context, name: str, model: CameraModel | LidarModel, mount: Matrix
) -> bpy.types.Object:
    """Put a new sensor on the vehicle, at a mount (4, 4), and make it the one that is selected."""
    scene = context.scene
    sensor = add_sensor(scene, drive_of(scene), name, model, np.array(mount, float))
    sensor.rotation_mode = "XYZ"
    choose(context, sensor)
    return sensor


def mount_property(default: tuple[float, float, float]) -> Any:
    """Return the property that is a new sensor's place."""
    return FloatVectorProperty(
        name="Mount",
        description="Position in the frame of the vehicle",
        default=default,
        subtype="XYZ_LENGTH",
        unit="LENGTH",
    )


class _OnVehicle(Needing):
    bl_options = {"REGISTER", "UNDO"}
    needs = (object_mode, vehicle)


class _OfSensor(Needing):
    """An operator that a sensor's row in the list has."""

    bl_options = {"REGISTER", "UNDO"}
    needs = (object_mode, vehicle)

    name: StringProperty(name="Sensor", options={"HIDDEN", "SKIP_SAVE"})

    def sensor(self: Any, context: bpy.types.Context) -> bpy.types.Object | None:
        """The sensor of that name; None, with a report, where there is none."""
        sensor = next(
            (obj for obj in imported_objects(context.scene, "CAMERA", "LIDAR") if obj.name == self.name), None
        )
        if sensor is None:
            self.report(
                {"ERROR"}, message('no sensor "{name}" in scene "{scene}"', name=self.name, scene=context.scene.name)
            )
        return sensor


class UNISIM_OT_look_through(_OfSensor, bpy.types.Operator):
    """Look through this camera and use its image size"""

    bl_label = "Look Through Camera"

    def execute(self, context: bpy.types.Context) -> set[str]:
        camera = self.sensor(context)
        if camera is None or camera.type != "CAMERA":
            return {"CANCELLED"}
        context.scene.camera = camera
        fit_resolution(context.scene)
        choose(context, camera)
        region = getattr(context.space_data, "region_3d", None)
        if region is not None:
            region.view_perspective = "CAMERA"
        return {"FINISHED"}


class UNISIM_OT_show_sensor(_OfSensor, bpy.types.Operator):
    """Show or hide this sensor; a hidden sensor is not part of views, sequences and scenarios"""

    bl_label = "Show or Hide Sensor"

    def execute(self, context: bpy.types.Context) -> set[str]:
        sensor = self.sensor(context)
        if sensor is None:
            return {"CANCELLED"}
        show_sensor(sensor, sensor.hide_render)
        look_ahead(context.scene)
        refresh([sensor])
        return {"FINISHED"}


class UNISIM_OT_add_camera(_OnVehicle, bpy.types.Operator):
    """Add a camera to the vehicle and make it the active camera"""

    bl_label = "Add Camera"

    width: IntProperty(name="Width", description="Image width", default=960, min=16, soft_max=3840, subtype="PIXEL")
    height: IntProperty(name="Height", description="Image height", default=540, min=16, soft_max=2160, subtype="PIXEL")
    fov_deg: FloatProperty(
        name="Horizontal FOV", description="Horizontal field of view in degrees", default=70.0, min=1.0, max=170.0
    )
    mount: mount_property((1.2, 0.0, 1.6))
    yaw_deg: FloatProperty(name="Yaw", description="Rotation to the left in degrees", default=0.0)
    pitch_deg: FloatProperty(name="Pitch", description="Rotation upwards in degrees", default=0.0)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Square pixels, the principal point in the middle, a global shutter."""
        focal = self.width / 2 / np.tan(np.radians(self.fov_deg) / 2)
        model = CameraModel(self.width, self.height, focal, focal, self.width / 2, self.height / 2)
        # a Blender camera looks down; upright and turned by -90 degrees it looks along x
        turn = Euler((np.radians(90 + self.pitch_deg), 0.0, np.radians(self.yaw_deg - 90)))
        context.scene.camera = put_on_vehicle(context, "camera", model, Matrix.LocRotScale(self.mount, turn, None))
        fit_resolution(context.scene)
        return {"FINISHED"}


class _Beams:
    """A maker's beam table, or one's own."""

    preset: EnumProperty(name="Beams", description="Beam table", items=PRESETS, default="pandar64")
    elevations: StringProperty(
        name="Elevations",
        description="Elevation angles of custom beams in degrees, separated by commas",
        default=OWN_TABLE,
    )
    columns: IntProperty(name="Columns", description="Firings per revolution of custom beams", default=1800, min=1)
    max_range_m: FloatProperty(
        name="Range", description="Maximum range of custom beams", default=200.0, min=1.0, unit="LENGTH"
    )

    def invoke(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_props_dialog(self) if self.preset == OWN else self.execute(context)

    def draw(self: Any, context: bpy.types.Context) -> None:
        """Draw the settings that count with the chosen preset."""
        for name in ("preset", *(("elevations", "columns", "max_range_m") if self.preset == OWN else ())):
            self.layout.prop(self, name)
        if hasattr(self, "mount"):
            self.layout.prop(self, "mount")

    def table(self) -> LidarModel:
        """The beam table. Raises `UnisimError`."""
        return (
            BEAM_TABLES[self.preset]()
            if self.preset != OWN
            else own_table(self.elevations, self.columns, self.max_range_m)
        )


class UNISIM_OT_add_lidar(_OnVehicle, _Beams, bpy.types.Operator):
    """Add a LiDAR to the vehicle"""

    bl_label = "Add LiDAR"

    mount: mount_property((0.0, 0.0, 2.0))

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        name = "lidar" if self.preset == OWN else self.preset
        put_on_vehicle(context, name, self.table(), Matrix.Translation(self.mount))
        return {"FINISHED"}


class UNISIM_OT_set_beams(Editing, _Beams, bpy.types.Operator):
    """Change the beam table of the selected LiDARs"""

    bl_label = "Change Beams"
    needs = (object_mode, selected("Select a LiDAR first", "LIDAR"))

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Replace the tables; mounts and times stay."""
        table = lidar_json(self.table())
        for lidar in chosen(context, "LIDAR"):
            lidar.unisim.model = table
        return {"FINISHED"}
