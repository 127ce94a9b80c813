"""Properties of files about muted edits and variants, and of the window about lists."""

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)


class UniSimMuted(bpy.types.PropertyGroup):
    """A muted edit. ``parked`` is the object with the edit, in no scene; None if the edit removes an object, or
    consists of ``look`` or ``scale`` alone. ``collection`` is where the object was, ``at_root``: in the scene's own
    collection. ``name`` and the rest are the line in the list."""

    # .blend files keep these under their names: `thing` is the object's name, `look` and `look_scene` the appearance
    kind: StringProperty()
    uid: StringProperty()
    part: StringProperty()
    what: StringProperty()
    what_parts: StringProperty()  # of what, so that it can be told in other languages; "" in files of earlier versions
    thing: StringProperty()
    start_s: FloatProperty()
    end_s: FloatProperty()
    first: IntProperty()
    last: IntProperty()
    parked: PointerProperty(type=bpy.types.Object)
    collection: PointerProperty(type=bpy.types.Collection)
    at_root: BoolProperty()
    look: StringProperty()
    look_scene: StringProperty()
    scale: FloatVectorProperty(size=3, default=(1.0, 1.0, 1.0))
    kept: StringProperty()  # what another carrier of edits keeps
    scale_lift_m: FloatProperty()


class UniSimEdits(bpy.types.PropertyGroup):
    """A scene's muted edits, and whether it is one of the variants that are rendered together."""

    muted: CollectionProperty(type=UniSimMuted)
    rendered: BoolProperty(name="Render", description="Render it with the selected variants", default=True)


PROPERTIES = (
    (bpy.types.Scene, "unisim_edits", PointerProperty(type=UniSimEdits)),
    (
        bpy.types.WindowManager,
        "unisim_edits_page",
        IntProperty(name="Page", description="Page of the list of edits", min=1, default=1),
    ),
    (
        bpy.types.WindowManager,
        "unisim_compared",
        StringProperty(description="The variant that the active one is compared with"),
    ),
)
