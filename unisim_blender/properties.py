"""What Blender's objects and scenes remember of the drive that they came from."""

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from .registering import add, take_away

KINDS = (
    ("NONE", "None", "Nothing of a drive"),
    ("EGO", "Ego vehicle", "The vehicle that recorded the drive"),
    ("CAMERA", "Camera", "A camera of the rig"),
    ("LIDAR", "LiDAR", "A LiDAR of the rig"),
    ("ACTOR", "Actor", "An annotated thing: a car, a person, a cone"),
    ("STATIC", "Static item", "A box of space round something without annotation"),
    ("POINTS", "LiDAR points", "A sweep's returns"),
    ("TRAJECTORY", "Trajectory", "What carries the keys of an object that rides on it"),
)
QUALITIES = (
    ("fast", "Fast", "Long steps, and fewer pixels by themselves"),
    ("balanced", "Balanced", "Pixels that are alike are traced together"),
    ("fine", "Fine", "Every pixel by itself, in steps of centimetres"),
    ("reference", "Reference", "Slow and plain: four times the scene's own samples"),
)
PASSES = (
    ("depth", "Depth", "Distance along each ray, and along the camera's axis"),
    ("normal", "Normal", "Normals of surfaces, in the world's axes"),
    ("instance", "Instance", "Which actor each pixel shows"),
    ("opacity", "Opacity", "How much of each pixel is nearer than the far field"),
    ("support", "Support", "Pixels that nothing recorded supports"),
)
POINT_COLOURS = (
    ("ONE", "One", "Recorded points yellow, simulated ones blue"),
    ("INTENSITY", "Intensity", "Blue to yellow"),
    ("DEPTH", "Depth", "Distance from the sensor, blue to red"),
    ("INSTANCE", "Instance", "A colour for each actor; recorded points, which have no actors, by class"),
)


class UniSimObject(bpy.types.PropertyGroup):
    """What an object stands for. Copies made with Blender's own tools have the same values: what a copy is called in a
    scenario is derived when the scenario is read."""

    kind: EnumProperty(name="Kind", items=KINDS, default="NONE")
    uid: StringProperty(name="Id", description="The id that the log or the scenario has for it")
    home: StringProperty(name="Name", description="The object's name when it was imported; a copy has another")
    look: StringProperty(name="Look", description="The actor whose look it has, where that is not its own")
    look_scene: StringProperty(
        name="Scene of the look", description="The trained scene that the look is from", subtype="DIR_PATH"
    )
    mesh: BoolProperty(name="Mesh", description="Whether its own surface, with all that is parented to it, is what sensors see")
    label: StringProperty(name="Class", description="The class of an actor that is a mesh")
    model: StringProperty(name="Sensor", description="Exact intrinsics or beam table, as JSON")
    stamp: StringProperty(description="Another one whenever LiDAR points are")
    rest_location: FloatVectorProperty(size=3, description="Where it was on its trajectory before its first key there")
    rest_rotation: FloatVectorProperty(
        size=4, default=(1.0, 0.0, 0.0, 0.0), description="How it was turned on its trajectory before its first key there"
    )


class UniSimItem(bpy.types.PropertyGroup):
    """A static item that was marked; ``name`` is its id. It stays here when its box is deleted: the item is gone then."""

    model: StringProperty(name="Box", description="The box round the item, as JSON")


class UniSimWarning(bpy.types.PropertyGroup):
    """What is odd about the object ``name``."""

    frame: IntProperty()
    text: StringProperty()


class UniSimScene(bpy.types.PropertyGroup):
    """What a scene was imported from."""

    log: StringProperty(name="Log", description="Folder of the recorded drive", subtype="DIR_PATH")
    scene: StringProperty(name="Trained scene", description="Folder of the neural scene trained on the log", subtype="DIR_PATH")
    origin: StringProperty(
        name="World origin", description="What was subtracted from the log's coordinates, three float64 as JSON"
    )
    trajectories: BoolProperty(description="Whether its moving objects ride on trajectories, as files of earlier versions do not")
    static_items: CollectionProperty(type=UniSimItem, name="Static items")
    out: StringProperty(name="Folder", description="Where a sequence is written", subtype="DIR_PATH", default="//render")
    quality: EnumProperty(name="Quality", description="How finely rays are sampled", items=QUALITIES, default="balanced")
    contact_shadows: BoolProperty(name="Contact shadows", description="Soft shadows under copied and inserted actors")
    show_ways: BoolProperty(
        name="Trajectories",
        description="Draw the trajectories of selected actors, with speeds and where they were recorded",
        default=True,
    )
    show_sensors: BoolProperty(
        name="Sensors", description="Whether cameras, LiDARs and the ego vehicle's axes are seen from outside", default=True
    )
    show_recorded: BoolProperty(name="Recorded points", description="Whether the frame's recorded LiDAR points are shown")
    show_simulated: BoolProperty(name="Simulated points", description="Whether the frame's simulated LiDAR points are shown")
    points_colour: EnumProperty(name="Colour", description="What colours LiDAR points", items=POINT_COLOURS, default="ONE")
    recorded_offset_m: FloatProperty(
        name="Recorded Beside",
        description="How far to the vehicle's left recorded LiDAR points are drawn, to be compared with simulated ones",
        unit="LENGTH",
    )
    clip_render: BoolProperty(
        name="Clip to Observed",
        description="F12 through a camera that the log does not have shows nothing but what the recording observed, "
        "on transparent ground",
    )
    opacity_pass: BoolProperty(name="Opacity pass", description="How much of each pixel is nearer than the far field")
    passes: EnumProperty(
        name="Passes", description="What a sequence holds beside colours", items=PASSES, options={"ENUM_FLAG"}, default={"depth"}
    )


CLASSES = (UniSimObject, UniSimItem, UniSimWarning, UniSimScene)


def register() -> None:
    """Add the properties to Blender's objects, scenes and window manager."""
    add(CLASSES)
    bpy.types.Object.unisim = PointerProperty(type=UniSimObject)
    bpy.types.Scene.unisim = PointerProperty(type=UniSimScene)
    bpy.types.WindowManager.unisim_renderer = StringProperty(description="What the last test of the renderer found")
    bpy.types.WindowManager.unisim_task = StringProperty(description="What runs in the background, and how far it is")
    bpy.types.WindowManager.unisim_warnings = CollectionProperty(type=UniSimWarning)
    bpy.types.WindowManager.unisim_progress = FloatProperty(subtype="FACTOR", min=0.0, max=1.0)


def unregister() -> None:
    """Take them away again; files keep what they hold."""
    manager = bpy.types.WindowManager
    del manager.unisim_warnings, manager.unisim_progress, manager.unisim_task, manager.unisim_renderer
    del bpy.types.Scene.unisim, bpy.types.Object.unisim
    take_away(CLASSES)
