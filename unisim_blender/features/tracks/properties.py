"""Properties of boxes that are corrected, and of the list of their doubtful places."""

import bpy
from bpy.props import BoolProperty, FloatProperty, FloatVectorProperty, PointerProperty, StringProperty

from ...bridge.importing.tracks import tracks_in


def show_certain(about: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """Show the boxes that are certain enough, and hide the others."""
    scene, layer = about.id_data, context.view_layer
    for obj in tracks_in(scene):
        if obj.name in layer.objects:
            obj.hide_set(obj.unisim_track.certainty < about.certainty)


class UniSimTrack(bpy.types.PropertyGroup):
    """What a box that is corrected stands for."""

    certainty: FloatProperty(
        name="Certainty",
        description="How certain it is that there is an actor in the box",
        min=0.0,
        max=1.0,
        default=1.0,
    )
    size_m: FloatVectorProperty(size=3, description="Length, width and height without the scale of the object")
    drawn: StringProperty(description="Keys that a person set, as JSON")
    track: StringProperty(description="All else as in a file of boxes, as JSON")


class UniSimTracks(bpy.types.PropertyGroup):
    """Settings of boxes that are corrected, of a scene."""

    certainty: FloatProperty(
        name="Certainty",
        description="Only boxes of at least this certainty are shown and saved",
        min=0.0,
        max=1.0,
        default=0.5,
        subtype="FACTOR",
        options=set(),
        update=show_certain,
    )
    refine: BoolProperty(
        name="Fit to Points",
        description="Move, turn and resize a followed box so that it encloses the points of all sweeps",
        default=True,
    )
    show_sides: BoolProperty(
        name="Three Sides",
        description="Show the points in the active box from above, from the side and from behind",
        default=True,
    )
    place: StringProperty(description="Doubtful place that is shown, as JSON")


PROPERTIES = (
    (bpy.types.Object, "unisim_track", PointerProperty(type=UniSimTrack)),
    (bpy.types.Scene, "unisim_tracks", PointerProperty(type=UniSimTracks)),
    (
        bpy.types.WindowManager,
        "unisim_following",
        StringProperty(description="Progress or error of boxes that are followed"),
    ),
)
