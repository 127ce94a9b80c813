"""Parts of an object that edits change, as the edits list tells them: their icons, and what of the
object carries them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

OWN_OBJECT, PLACE = "own_object", "place"
"""Carriers of an edit: an object that would not be there without it; where an object of the drive is, and
whether it is there."""


@dataclass(frozen=True)
class Part:
    """A part by its name, which files keep. ``icons`` are those of lines that begin with a word.

    ``carrier`` is the module of `bridge/changes/carriers` that mutes, unmutes and takes back its edits; "" where
    nothing can be. ``is_absence``: whether the object is gone, so that none of its other edits counts beside.
    """

    name: str
    icon: str
    carrier: str = PLACE
    is_absence: bool = False
    icons: Mapping[str, str] = field(default_factory=dict)

    def icon_of(self, words: str) -> str:
        """Name of the icon of a line."""
        return next((icon for word, icon in self.icons.items() if words.startswith(word)), self.icon)


PARTS = {
    part.name: part
    for part in (
        Part("REMOVE", "TRASH", is_absence=True),
        Part("APPEARANCE", "SHADING_TEXTURE", "appearance"),
        Part("MOVE", "ORIENTATION_GLOBAL", icons={"Retimed": "TIME"}),
        Part("COPY", "DUPLICATE", OWN_OBJECT),
        Part("INSERT", "ADD", OWN_OBJECT),
        Part("MESH", "MESH_MONKEY", OWN_OBJECT),
        Part("SCALE", "FULLSCREEN_ENTER", "scale"),
        Part("BODY", "AUTO", OWN_OBJECT),
        Part("SENSOR", "CAMERA_DATA"),
        Part("EGO", "AUTO"),
        Part("PROBLEM", "ERROR", ""),
    )
}
"""The parts by their names. A reader may add one of its own."""
