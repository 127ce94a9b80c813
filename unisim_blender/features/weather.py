"""Weather of a drive: its properties, and the panel Weather, a part of the panel
Sensors. Reading and writing them: `bridge.objects.weather`."""

import bpy
from bpy.props import FloatProperty, IntProperty, PointerProperty, StringProperty

from ..bridge.objects.weather import CLEAR_M
from ..core.scenario.weather import MIN_VISIBILITY_M
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
    seed: IntProperty(
        name="Seed", description="Seed of drops, flakes and the returns of fog", min=0, max=2**31 - 1, options=set()
    )
    sensors: StringProperty(description="What the weather of the imported scenario states of sensors, as JSON")


class UNISIM_PT_weather(DrivePanel, bpy.types.Panel):
    """Fog, rain, snow and wet ground in images and sweeps; keys animate them"""

    bl_label = "Weather"
    bl_parent_id = "UNISIM_PT_sensors"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        column = settings_column(self.layout)
        column.use_property_decorate = True
        for name in ("visibility_m", "rain_mm_h", "snow_mm_h", "wetness", "seed"):
            column.prop(context.scene.unisim_weather, name)


PROPERTIES = ((bpy.types.Scene, "unisim_weather", PointerProperty(type=UniSimWeather)),)
