"""Weather and sun of a drive: their properties, and the panels Weather and Sun, parts of the panel
Sensors. Reading and writing them: `bridge.objects.weather`."""

import math

import bpy
from bpy.props import BoolProperty, FloatProperty, FloatVectorProperty, IntProperty, PointerProperty, StringProperty

from ..bridge.objects.weather import CLEAR_M, add_street_lamp
from ..bridge.window import choose, drive, object_mode
from ..core.scenario.light import MIN_ELEVATION_DEG
from ..core.scenario.weather import MAX_LAMP_HEIGHT_M, MIN_VISIBILITY_M
from ..core.scenario.weather import MIN_ELEVATION_DEG as NIGHT_DEG
from ..core.world.light import MAX_STRENGTH, direction_to
from ..core.world.weather import AS_RECORDED_DEG
from .operator_bases import EditsObjects, in_metres
from .sidebar import DrivePanel, settings_column


class UniSimWeather(bpy.types.PropertyGroup):
    """Weather, in images and sweeps"""

    visibility_m: FloatProperty(
        name="Visibility",
        description="Fog: distance at which contrast is 2 %; without fog it is 100 km",
        default=CLEAR_M,
        min=MIN_VISIBILITY_M,
        max=CLEAR_M,
        soft_max=2000.0,
        unit="LENGTH",
    )
    rain_mm_h: FloatProperty(name="Rain", description="Rain in millimetres an hour", min=0.0, max=200.0, soft_max=50.0)
    snow_mm_h: FloatProperty(
        name="Snow", description="Snow in millimetres of liquid water an hour", min=0.0, max=20.0, soft_max=5.0
    )
    wetness: FloatProperty(
        name="Wetness", description="Wet part of the ground; rain adds to it", min=0.0, max=1.0, subtype="FACTOR"
    )
    sun_elevation: FloatProperty(
        name="Time of Day",
        description="Elevation of the sun in images, with lamps below 3 degrees; at 90 degrees the recorded light",
        subtype="ANGLE",
        default=math.radians(AS_RECORDED_DEG),
        min=math.radians(NIGHT_DEG),
        max=math.radians(AS_RECORDED_DEG),
    )
    seed: IntProperty(
        name="Seed", description="Seed of drops, flakes and the returns of fog", min=0, max=2**31 - 1, options=set()
    )
    sensors: StringProperty(description="What the weather of the imported scenario states of sensors, as JSON")


class UNISIM_PT_weather(DrivePanel, bpy.types.Panel):
    """Fog, rain, snow and wet ground in images and sweeps, and the time of day in images; keys animate them"""

    bl_label = "Weather"
    bl_parent_id = "UNISIM_PT_sensors"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        column = settings_column(self.layout)
        column.use_property_decorate = True
        for name in ("visibility_m", "rain_mm_h", "snow_mm_h", "wetness", "sun_elevation", "seed"):
            column.prop(context.scene.unisim_weather, name)
        column.operator("unisim.add_street_lamp", icon="ADD")


class UNISIM_OT_add_street_lamp(EditsObjects, bpy.types.Operator):
    """Put a street lamp, on by night, with its foot at the 3D cursor; its scale changes the height"""

    bl_label = "Add Street Lamp"
    needs = (object_mode, drive)

    height_m: in_metres(
        "Height", "Height of the lamp above the ground", 8.0, once=False, min=0.5, max=MAX_LAMP_HEIGHT_M
    )

    def edit(self, context: bpy.types.Context) -> None:
        choose(context, add_street_lamp(context.scene, context.scene.cursor.location, self.height_m))


def _turn(self: "UniSimSun", direction: tuple[float, float, float]) -> None:
    self.azimuth = math.atan2(direction[1], direction[0])
    self.elevation = math.asin(min(max(direction[2], -1.0), 1.0))


class UniSimSun(bpy.types.PropertyGroup):
    """Sun by which edited actors cast shadows in images"""

    enabled: BoolProperty(
        name="Sun", description="Edited actors cast shadows, those of removed parked ones go", options=set()
    )
    azimuth: FloatProperty(
        name="Azimuth",
        description="Direction to the sun, counter-clockwise from the world's x",
        subtype="ANGLE",
        min=-2 * math.pi,
        max=2 * math.pi,
    )
    elevation: FloatProperty(
        name="Elevation",
        description="Height of the sun above the horizon",
        subtype="ANGLE",
        default=math.pi / 4,
        min=math.radians(MIN_ELEVATION_DEG),
        max=math.pi / 2,
    )
    strength: FloatProperty(
        name="Strength",
        description="The sun's part of the light on sunlit level ground: how dark shadows are",
        default=0.7,
        min=0.0,
        max=MAX_STRENGTH,
        subtype="FACTOR",
    )
    direction: FloatVectorProperty(
        name="Direction",
        description="Direction to the sun: drag the ball",
        subtype="DIRECTION",
        get=lambda self: direction_to(self.azimuth, self.elevation).tolist(),
        set=_turn,
        options=set(),
    )


class UNISIM_PT_sun(DrivePanel, bpy.types.Panel):
    """Where the sun stands by which edited actors cast shadows in images; keys animate it. The view draws the direction"""

    bl_label = "Sun"
    bl_parent_id = "UNISIM_PT_sensors"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header(self, context: bpy.types.Context) -> None:
        self.layout.prop(context.scene.unisim_sun, "enabled", text="")

    def draw(self, context: bpy.types.Context) -> None:
        sun, split = context.scene.unisim_sun, self.layout.split(factor=0.3)
        split.active = sun.enabled
        split.prop(sun, "direction", text="")
        column = settings_column(split)
        column.use_property_decorate = True
        for name in ("azimuth", "elevation", "strength"):
            column.prop(sun, name)


PROPERTIES = (
    (bpy.types.Scene, "unisim_weather", PointerProperty(type=UniSimWeather)),
    (bpy.types.Scene, "unisim_sun", PointerProperty(type=UniSimSun)),
)
