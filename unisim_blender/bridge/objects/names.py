"""Readable names for imported actors, also where the word for the colour becomes known after the import.

Name and original name change together, and the copies' original name with them: an actor that is renamed here counts neither as
renamed by a person nor as a copy.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import bpy

from ...core.actor_images.kept import kept_images
from ...core.actor_images.names import full_name, plain_names
from ...core.world.drive import Actor
from .imported import things
from .source import Source


def names_at_import(source: Source) -> dict[str, str]:
    """Return the names of a source's actors by id, with the words for their colours where these are kept already."""
    kept = kept_images(source.log_path) or {}
    words = {uid: one.word for uid, one in kept.items()}
    return {uid: full_name(plain, words.get(uid, "")) for uid, plain in plain_names(named_actors(source)).items()}


def named_actors(source: Source) -> dict[str, Actor]:
    """Return the actors that are counted: all of the log's, so that a scene trained on it has the same names."""
    return {**source.drive.actors, **(source.log.drive.actors if source.log is not None else {})}


def apply_words(scene: bpy.types.Scene, plain: Mapping[str, str], words: Mapping[str, str]) -> dict[str, str]:
    """Add the words for their colours to the names of actors that still have the name "class number" from the import.

    Names that people gave, and those of files from earlier versions, stay. Return the new names by the old ones.
    """
    found: dict[str, list[bpy.types.Object]] = {}
    for thing in things(scene, "ACTOR"):
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


def is_plain(name: str, plain: str) -> bool:
    """Return whether a name is the plain one, with the number that Blender adds where another scene has that name too."""
    return re.fullmatch(re.escape(plain) + r"(\.\d{3,})?", name) is not None
