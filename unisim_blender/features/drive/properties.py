"""Properties of Blender's objects and scenes about the drive that they were imported from."""

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    IntVectorProperty,
    PointerProperty,
    StringProperty,
)

from ...core.scenario.types import FRAME_FORMATS, SEQUENCE_FORMATS
from ..sidebar import switch_of

# a .blend file holds these by their places: append, and never reorder
KINDS = (
    ("NONE", "None", "Not part of a drive"),
    ("EGO", "Ego vehicle", "Vehicle that recorded the drive"),
    ("CAMERA", "Camera", "Camera of the vehicle"),
    ("LIDAR", "LiDAR", "LiDAR of the vehicle"),
    ("ACTOR", "Actor", "Annotated object: a car, a pedestrian, a cone"),
    ("STATIC", "Static item", "Box around an object without annotation"),
    ("POINTS", "LiDAR points", "Returns of a sweep"),
    ("BODY", "Ego body", "Mesh of the body of the ego vehicle, which the sensors of the vehicle do not see"),
    ("TRAJECTORY", "Trajectory", "Hidden parent that carries the recorded keyframes of a moving object"),
    ("TRACK", "Box", "Box of an actor that is found, drawn or corrected, before it is saved"),
    ("STREET_LAMP", "Street lamp", "Lines from the foot to the head of a lamp that is on by night"),
)
SIGHTS = (
    ("AUTO", "Off the vehicle", "The sensor sees the body of the ego vehicle unless it is mounted on the vehicle"),
    (
        "ALWAYS",
        "Always",
        "The sensor always sees the body of the ego vehicle, for example from a camera that follows the vehicle",
    ),
    ("NEVER", "Never", "The sensor never sees the body of the ego vehicle"),
)
QUALITIES = (
    ("fast", "Fast", "Long steps, and fewer pixels traced individually"),
    ("balanced", "Balanced", "Similar pixels are traced together"),
    ("fine", "Fine", "Every pixel is traced individually, in steps of centimetres"),
    ("reference", "Reference", "Slow: four times the number of samples of the scene"),
)
# a .blend file holds the flags of these by their places: append, and never reorder
PASSES = (
    ("depth", "Depth", "Distance along each ray and along the optical axis"),
    ("normal", "Normal", "Surface normals in world space"),
    ("instance", "Instance", "Actor that each pixel shows"),
    ("opacity", "Opacity", "Opacity of everything nearer than the background model"),
    ("unsupported", "Unsupported", "Pixels that no recorded data supports"),
    ("confidence", "Confidence", "Probability that each pixel is right, by what was recorded"),
)
SEQUENCE_SENSORS = (
    ("ALL", "All Sensors", "All cameras and LiDARs of the scene"),
    ("CAMERA", "Active Camera", "Only the active camera of the scene"),
    ("SELECTED", "Selected Sensors", "The selected cameras and LiDARs"),
)
# a .blend file holds these by their places
POINT_COLOURS = (
    ("ONE", "Single", "Recorded points are yellow, simulated points blue"),
    ("INTENSITY", "Intensity", "Intensity of each return"),
    ("DEPTH", "Range", "Distance from the sensor"),
    ("INSTANCE", "Instance", "Class of the actor that was hit, each actor in a shade of its own"),
    ("RING", "Ring", "Number of the beam in the table of the LiDAR"),
    ("DIFFERENCE", "Difference", "Recorded minus simulated range of the same beam, where both are shown"),
)


RELATIVE = {"ANIMATABLE", *({"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (5, 0, 0) else ())}
"""Of a path that may begin with //, which Blender before 5.0 allows everywhere."""


class UniSimObject(bpy.types.PropertyGroup):
    """The part of a drive that an object stands for. Copies made with Blender's own tools have the same values: what a
    copy is called in a scenario is derived when the scenario is read."""

    # .blend files keep these under their names: `home` is the original name, `look` and `look_scene` the appearance
    kind: EnumProperty(name="Kind", description="What of a drive the object stands for", items=KINDS, default="NONE")
    uid: StringProperty(name="Id", description="Identifier in the log or the scenario")
    home: StringProperty(name="Name", description="Name of the object when it was imported; copies have another name")
    look: StringProperty(name="Appearance", description="Actor whose appearance this object has; empty for its own")
    look_scene: StringProperty(
        name="Appearance scene", description="Trained scene that provides the appearance", subtype="DIR_PATH"
    )
    mesh: BoolProperty(name="Mesh", description="Sensors see the mesh of the object and of its children")
    label: StringProperty(name="Class", description="Class of a mesh actor")
    model: StringProperty(name="Sensor", description="Exact intrinsics or beam table, as JSON")
    sees_ego_body: EnumProperty(
        name="Sees ego body", description="When a sensor sees the body of the ego vehicle", items=SIGHTS
    )
    row: StringProperty(description="Row that the object stands in, as an edit of a scenario")
    stamp: StringProperty(description="Changes whenever the LiDAR points change")
    called: StringProperty(description="Identifier in scenarios, for objects that were copied with a variant")
    called_as: StringProperty(description="Object name for which that identifier is valid")
    maneuvers: StringProperty(description="Maneuvers that lead to its trajectory, as JSON")
    rest_location: FloatVectorProperty(size=3, description="Offset from the trajectory before the first keyframe")
    rest_scale: FloatVectorProperty(
        size=3, description="Scale that the location accounts for; zero where none was noted"
    )
    scale_lift_m: FloatProperty(description="Distance by which the object was lifted along its own axis for its scale")
    rest_rotation: FloatVectorProperty(
        size=4,
        default=(1.0, 0.0, 0.0, 0.0),
        description="Rotation relative to the trajectory before the first keyframe",
    )


class UniSimItem(bpy.types.PropertyGroup):
    """A static item that was marked; ``name`` is its id. It stays here when its box is deleted: the
    item is gone then."""

    model: StringProperty(name="Box", description="Box around the item, as JSON")


class UniSimWarning(bpy.types.PropertyGroup):
    """A finding on the object ``name``, with place and time."""

    frame: IntProperty(name="Frame", description="Frame at which it is found")
    time_s: FloatProperty(name="Time", description="Seconds of the log", unit="TIME_ABSOLUTE")
    place: FloatVectorProperty(name="Location", description="World location of the object at that time", size=3)
    text: StringProperty(name="Warning", description="What is implausible")
    text_parts: StringProperty(
        options={"HIDDEN"}
    )  # so that it can be told in other languages; "" in files of earlier versions


class UniSimCheck(bpy.types.PropertyGroup):
    """Result of Check Edits; it is saved with the scene."""

    warnings: CollectionProperty(type=UniSimWarning, name="Warnings")
    state: StringProperty(
        name="State", description="Digest of the edits that were checked; empty before the first check"
    )
    checked: StringProperty(name="Checked", description="Local date and time of the check")
    shadows: PointerProperty(
        type=UniSimWarning, name="Shadows", description="What becomes of the recorded shadows of edited actors"
    )


FORMATS = tuple((name, name, about) for name, about in (FRAME_FORMATS | SEQUENCE_FORMATS).items())


class UniSimScene(bpy.types.PropertyGroup):
    """The log and the trained scene that a scene was imported from, and its settings."""

    log: StringProperty(name="Log", description="Folder of the recorded drive", subtype="DIR_PATH")
    scene: StringProperty(
        name="Trained scene", description="Folder of the neural scene trained on the log", subtype="DIR_PATH"
    )
    origin: StringProperty(
        name="World origin",
        description="Offset subtracted from the coordinates of the log, three float64 values as JSON",
    )
    first_steps: BoolProperty(name="First Steps", description="Show the first steps in the sidebar until all are done")
    done_steps: StringProperty(description="First steps that are done, with spaces between")
    skipped_sensors: StringProperty(description="Sensors of the log that were not imported, as JSON")
    stated: StringProperty(
        description="Frames, times and more of the imported scenario, as JSON; empty where it states none"
    )
    stated_range: IntVectorProperty(
        size=3,
        description="Frame range for which the captures of the imported scenario hold: first frame, last frame, step",
    )
    trajectories: BoolProperty(
        description="Moving objects are children of trajectories; files of earlier versions are converted"
    )
    static_items: CollectionProperty(type=UniSimItem, name="Static items")
    out: StringProperty(
        name="Folder",
        description="Output folder of sequences",
        subtype="DIR_PATH",
        default="//render",
        options=RELATIVE,
    )
    quality: EnumProperty(
        name="Quality", description="Sampling density along rays", items=QUALITIES, default="balanced"
    )
    sequence_sensors: EnumProperty(
        name="Sensors", description="Sensors that a sequence renders", items=SEQUENCE_SENSORS, default="ALL"
    )
    sequence_width: IntProperty(
        name="Width",
        description="Image width of sequences in pixels",
        default=0,
        min=0,
        soft_min=8,
        subtype="PIXEL",
    )
    has_sequence_width: switch_of(
        "sequence_width",
        lambda self: self.id_data.render.resolution_x,
        "Set Width",
        "Images of sequences have this width; while off, each camera has its own",
    )
    contact_shadows: BoolProperty(name="Contact shadows", description="Soft shadows under copied and inserted actors")
    fill_ground: BoolProperty(
        name="Fill Ground",
        description="Ground and façades that nobody saw have the texture of the street around them, computed once for a "
        "trained scene",
    )
    fixer: StringProperty(
        name="Fixer",
        description="Function that draws anew what no recorded image shows, after ground is filled: its name (learned: a "
        "trained network), or module:function",
    )
    detail: BoolProperty(
        name="Recorded Detail",
        description="Images of a trained scene get the fine detail that recorded images near by show; the log must have them",
    )
    show_ways: BoolProperty(
        name="Trajectories",
        description="Draw trajectories of the selected actors with their speed, and the recorded trajectories",
        default=True,
    )
    show_sensors: BoolProperty(
        name="Sensors",
        description="Show cameras, LiDARs and the axes of the ego vehicle in views that do not look through a sensor",
        default=True,
    )
    show_recorded: BoolProperty(
        name="Recorded points", description="Show the recorded LiDAR points of the current frame"
    )
    show_simulated: BoolProperty(
        name="Simulated points", description="Show simulated LiDAR points of the current frame"
    )
    show_drops: BoolProperty(name="Dropped Beams", description="Show LiDAR beams that did not return")
    points_colour: EnumProperty(
        name="Colour", description="Attribute that colours LiDAR points", items=POINT_COLOURS, default="ONE"
    )
    show_timeline: BoolProperty(
        name="Presence Timeline",
        description="Draw a bar over the lower part of the view for each actor while it is present; a click on a bar goes there",
    )
    recorded_offset_m: FloatProperty(
        name="Recorded Offset",
        description="Offset of the recorded LiDAR points to the left of the vehicle, for comparison with simulated points",
        unit="LENGTH",
    )
    clip_render: BoolProperty(
        name="Clip to Observed",
        description="F12 through a camera that the log does not have shows nothing but what the recording observed, "
        "on transparent ground",
    )
    opacity_pass: BoolProperty(
        name="Opacity pass", description="Opacity of everything nearer than the background model"
    )
    passes: EnumProperty(
        name="Passes",
        description="Passes that a sequence contains in addition to colours",
        items=PASSES,
        options={"ENUM_FLAG"},
        default={"depth"},
    )
    formats: EnumProperty(
        name="Formats",
        description="Formats that sequences are written in",
        items=FORMATS,
        options={"ENUM_FLAG"},
        default=set(FRAME_FORMATS),
    )

    @property
    def fill(self) -> str:
        """What is shown where nobody saw: a fixer, or one of `sensors.frames.FILLS`."""
        return self.fixer or ("texture" if self.fill_ground else "none")


PROPERTIES = (
    (bpy.types.Object, "unisim", PointerProperty(type=UniSimObject)),
    (bpy.types.Scene, "unisim", PointerProperty(type=UniSimScene)),
    (bpy.types.Scene, "unisim_check", PointerProperty(type=UniSimCheck)),
    (bpy.types.WindowManager, "unisim_renderer", StringProperty(description="Result of the last test of the renderer")),
    (
        bpy.types.WindowManager,
        "unisim_points",
        StringProperty(description="Progress or error of simulated LiDAR points"),
    ),
)
