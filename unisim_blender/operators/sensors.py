"""New cameras and LiDARs on the vehicle."""

import bpy
import numpy as np
from bpy.props import EnumProperty, FloatProperty, FloatVectorProperty, IntProperty

from ..bridge.cameras import set_model
from ..bridge.importing import fit_resolution
from ..bridge.rig import lidar_json
from ..bridge.selection import choose
from ..bridge.things import collection_of, things
from ..core.drive import CameraModel
from ..core.sensors.beam_tables import BEAM_TABLES

PRESETS = [(name, name.upper(), table.__doc__ or "") for name, table in BEAM_TABLES.items()]


def ride(context: bpy.types.Context, thing: bpy.types.Object, kind: str, place: tuple[float, float, float]) -> None:
    """Put a new sensor on the vehicle and make it the one that is selected."""
    ego = next(things(context.scene, "EGO"))
    collection_of(context.scene, kind).objects.link(thing)
    thing.unisim.kind, thing.unisim.uid = kind, thing.name
    thing.parent = ego
    thing.location = place
    choose(context, thing)


class _OnVehicle:
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The vehicle has to be there."""
        return context.mode == "OBJECT" and next(things(context.scene, "EGO"), None) is not None


class UNISIM_OT_add_camera(_OnVehicle, bpy.types.Operator):
    """Put a new camera on the vehicle and look through it"""

    bl_idname = "unisim.add_camera"
    bl_label = "Add Camera"

    width: IntProperty(name="Width", default=960, min=16, soft_max=3840, subtype="PIXEL")
    height: IntProperty(name="Height", default=540, min=16, soft_max=2160, subtype="PIXEL")
    fov_deg: FloatProperty(name="Horizontal view", description="Degrees", default=70.0, min=1.0, max=170.0)
    mount: FloatVectorProperty(
        name="Mount", description="On the vehicle", default=(1.2, 0.0, 1.6), subtype="XYZ_LENGTH", unit="LENGTH"
    )
    yaw_deg: FloatProperty(name="Yaw", description="Degrees to the left", default=0.0)
    pitch_deg: FloatProperty(name="Pitch", description="Degrees up", default=0.0)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Square pixels, the principal point in the middle, a global shutter."""
        focal = self.width / 2 / np.tan(np.radians(self.fov_deg) / 2)
        camera = bpy.data.objects.new("camera", bpy.data.cameras.new("UniSim camera"))
        set_model(camera, CameraModel(self.width, self.height, focal, focal, self.width / 2, self.height / 2))
        ride(context, camera, "CAMERA", tuple(self.mount))
        # a Blender camera looks down; upright and turned by -90 degrees it looks along x
        camera.rotation_euler = (np.radians(90 + self.pitch_deg), 0.0, np.radians(self.yaw_deg - 90))
        context.scene.camera = camera
        fit_resolution(context.scene)
        return {"FINISHED"}


class UNISIM_OT_add_lidar(_OnVehicle, bpy.types.Operator):
    """Put a new LiDAR on the vehicle"""

    bl_idname = "unisim.add_lidar"
    bl_label = "Add LiDAR"

    preset: EnumProperty(name="Beams", items=PRESETS, default="pandar64")
    mount: FloatVectorProperty(
        name="Mount", description="On the vehicle", default=(0.0, 0.0, 2.0), subtype="XYZ_LENGTH", unit="LENGTH"
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        """With the maker's beam table."""
        lidar = bpy.data.objects.new(self.preset, None)
        lidar.empty_display_type, lidar.empty_display_size = "CONE", 0.4
        lidar.unisim.model = lidar_json(BEAM_TABLES[self.preset]())
        ride(context, lidar, "LIDAR", tuple(self.mount))
        return {"FINISHED"}


CLASSES = (UNISIM_OT_add_camera, UNISIM_OT_add_lidar)
