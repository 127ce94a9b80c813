"""Parts of an object that edits change, as the edits list tells them: their icons, and what of the
object carries them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

OWN_OBJECT, PLACE = "own_object", "place"
"""Carriers of an edit: an object that would not be there without it; where an object of the drive is, and
whether it is there."""


@dataclass(frozen=True)
class EditPart:
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
        EditPart("REMOVE", "TRASH", is_absence=True),
        EditPart("APPEARANCE", "SHADING_TEXTURE", "appearance"),
        EditPart("MOVE", "ORIENTATION_GLOBAL", icons={"Retimed": "TIME"}),
        EditPart("COPY", "DUPLICATE", OWN_OBJECT),
        EditPart("INSERT", "ADD", OWN_OBJECT),
        EditPart("MESH", "MESH_MONKEY", OWN_OBJECT),
        EditPart("SCALE", "FULLSCREEN_ENTER", "scale"),
        EditPart("BODY", "AUTO", OWN_OBJECT),
        EditPart("SENSOR", "CAMERA_DATA"),
        EditPart("EGO", "AUTO"),
        EditPart("PROBLEM", "ERROR", ""),
    )
}
"""The parts by their names. A reader may add one of its own."""
