"""Options of each 3D view for a rendered image: beside the recorded one, with what is unsupported, clipped to
what was observed.

Every view has options of its own, so one can show the recorded image beside another that shows the rendered one.
Blender keeps no properties of extensions with its views, so they are kept here, until another file is opened.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import bpy
from bpy.app.handlers import persistent
from bpy.props import BoolProperty, EnumProperty, FloatProperty, PointerProperty

MODES = (
    ("RENDERED", "Rendered", "The rendered image alone", "SHADING_RENDERED", 0),
    (
        "SPLIT",
        "Split",
        "The recorded image left of a line, the rendered one right of it: drag the line",
        "MOD_MIRROR",
        1,
    ),
    (
        "DIFFERENCE",
        "Difference",
        "How far the rendered image is from the recorded one, each colour by itself",
        "SELECT_SUBTRACT",
        2,
    ),
    ("FLICKER", "Flicker", "The recorded and the rendered image by turns, four times a second", "FILE_REFRESH", 3),
    ("RECORDED", "Recorded", "The recorded image alone", "IMAGE_DATA", 4),
)
NAMES = tuple(mode[0] for mode in MODES)


@dataclass
class ViewOptions:
    """``mode`` is one of `MODES`; ``split`` is where the line is, as a share of the image's width; ``gain`` multiplies
    differences; ``unsupported``: whether these pixels are hatched; ``confidence``: whether pixels are coloured by it;
    ``clip``: whether a view through no camera shows nothing but what was observed."""

    mode: str = "RENDERED"
    split: float = 0.5
    gain: float = 4.0
    unsupported: bool = False
    confidence: bool = False
    clip: bool = True


_options: dict[int, ViewOptions] = {}
"""By the address of a view's space."""


def options_of(space: Any) -> ViewOptions:
    """Return the options of a 3D view; of what is none, those that nothing shows."""
    key = space.as_pointer() if isinstance(space, bpy.types.SpaceView3D) else 0
    return _options.setdefault(key, ViewOptions())


def _of_view(kind: Any, option: str, **settings: Any) -> Any:
    """Return a property that is an option of the 3D view that is drawn or used; a mode is a number of `NAMES`."""

    def get(self: Any) -> Any:
        value = getattr(options_of(bpy.context.space_data), option)
        return NAMES.index(value) if option == "mode" else value

    def put(self: Any, value: Any) -> None:
        setattr(options_of(bpy.context.space_data), option, NAMES[value] if option == "mode" else value)
        if bpy.context.area is not None:
            bpy.context.area.tag_redraw()

    return kind(get=get, set=put, **settings)


class UniSimView(bpy.types.PropertyGroup):
    """The options of the 3D view that is drawn or used; it holds nothing of its own."""

    mode: _of_view(EnumProperty, "mode", name="Image", description="Which images the view shows", items=MODES)
    split: _of_view(
        FloatProperty, "split", name="Split", min=0.0, max=1.0, subtype="FACTOR",
        description="Where the line between the recorded and the rendered image is, as a share of the image's width",
    )  # fmt: skip
    gain: _of_view(
        FloatProperty, "gain", name="Gain", min=1.0, max=64.0, description="Factor by which differences are multiplied"
    )
    unsupported: _of_view(
        BoolProperty, "unsupported", name="Unsupported",
        description="Hatch pixels in red that show what nothing recorded supports",
    )  # fmt: skip
    confidence: _of_view(
        BoolProperty, "confidence", name="Confidence",
        description="Colour pixels by how probable it is that they are right: clear from 80 %, orange at 50 %, red below 20 %",
    )  # fmt: skip
    clip: _of_view(
        BoolProperty, "clip", name="Clip to Observed",
        description="Show only what the recording observed, without what lies in front of it, in views that do not look "
        "through a camera",
    )  # fmt: skip


@persistent
def forget(*_: object) -> None:
    """Forget all views: another file has others, perhaps at the same addresses."""
    _options.clear()


HANDLERS = (("load_post", forget),)
PROPERTIES = ((bpy.types.WindowManager, "unisim_view", PointerProperty(type=UniSimView)),)


unregister = forget
