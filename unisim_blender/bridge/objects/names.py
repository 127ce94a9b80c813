"""Readable names for imported actors, also where the word for the colour becomes known after the import.

Name and original name change together, and the copies' original name with them: an actor that is renamed here counts
neither as renamed by a person nor as a copy.
"""

from __future__ import annotations

from collections.abc import Mapping

import bpy

from ...core.actor_images.names import full_name
from ...editing.actors.table import is_plain
from .imported import imported_objects


def apply_words(scene: bpy.types.Scene, plain: Mapping[str, str], words: Mapping[str, str]) -> dict[str, str]:
    """Add the words for their colours to the names of actors that still have the name "class number" from the import.

    Names that people gave, and those of files from earlier versions, stay. Return the new names by the old ones.
    """
    found: dict[str, list[bpy.types.Object]] = {}
    for obj in imported_objects(scene, "ACTOR"):
        if words.get(obj.unisim.uid) and obj.unisim.uid in plain:
            found.setdefault(obj.unisim.uid, []).append(obj)
    renamed = {}
    for uid, standing in found.items():
        own = next((obj for obj in standing if obj.name == obj.unisim.home), None)
        if own is None or not is_plain(own.name, plain[uid]):
            continue
        before = own.name
        own.name = full_name(plain[uid], words[uid])
        for obj in standing:
            if obj.unisim.home == before:
                obj.unisim.home = own.name
        renamed[before] = own.name
    return renamed
