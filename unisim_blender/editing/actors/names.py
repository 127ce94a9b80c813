"""Names of actors: those that an import gives, and which of them nobody has changed."""

from __future__ import annotations

import re

from ...core.actor_images.cache import kept_images
from ...core.actor_images.names import full_name, plain_names
from ...core.world.drive import Actor
from ..sampled.source import DriveSource


def names_at_import(source: DriveSource) -> dict[str, str]:
    """Return the names of a source's actors by id, with the words for their colours where these are kept already."""
    kept = kept_images(source.log_path) or {}
    words = {uid: one.word for uid, one in kept.items()}
    return {uid: full_name(plain, words.get(uid, "")) for uid, plain in plain_names(named_actors(source)).items()}


def named_actors(source: DriveSource) -> dict[str, Actor]:
    """Return the actors that are counted: all of the log's, so that a scene trained on it has the same names."""
    return {**source.drive.actors, **(source.log.drive.actors if source.log is not None else {})}


def is_plain(name: str, plain: str) -> bool:
    """Return whether a name is the plain one, with the number that Blender adds where another scene
    has that name too."""
    return re.fullmatch(re.escape(plain) + r"(\.\d{3,})?", name) is not None
