"""Readable names for imported actors, also where the word for the colour becomes known after the import.

Name and original name change together, and the copies' original name with them: an actor that is renamed here counts neither as
renamed by a person nor as a copy.
"""

from __future__ import annotations

from collections.abc import Mapping

import bpy

from ...core.actor_images.names import full_name
from ...editing.actors.names import is_plain
from .imported import imported_objects


def apply_words(scene: bpy.types.Scene, plain: Mapping[str, str], words: Mapping[str, str]) -> dict[str, str]:
    """Add the words for their colours to the names of actors that still have the name "class number" from the import.

    Names that people gave, and those of files from earlier versions, stay. Return the new names by the old ones.
    """
    found: dict[str, list[bpy.types.Object]] = {}
    for thing in imported_objects(scene, "ACTOR"):
        if words.get(thing.unisim.uid) and thing.unisim.uid in plain:
            found.setdefault(thing.unisim.uid, []).append(thing)
    renamed = {}
    for uid, standing in found.items():
        own = next((thing for thing in standing if thing.name == thing.unisim.home), None)
        if own is None or not is_plain(own.name, plain[uid]):
            continue
        before = own.name
        own.name = full_name(plain[uid], words[uid])
        for thing in standing:
            if thing.unisim.home == before:
                thing.unisim.home = own.name
        renamed[before] = own.name
    return renamed
