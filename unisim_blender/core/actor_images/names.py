"""Names of actors that people can read: class, a running number, a word for the colour."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from ..world.classes import motion_of
from ..world.drive import Actor

VAGUE = ("other", "uncommon")
"""Last words of a class that say less than the words before them."""


GROUP_WORDS = tuple(
    (group, word)
    for group, words in (
        ("CYCLE", "bicycl motorcycl motorbike cyclist scooter mobility pedicab rider wheeled"),
        ("PERSON", "pedestrian person people human signaler stroller wheelchair"),
        ("CAR", "pickup"),
        ("TRUCK", "truck bus train tram trolley rail trailer towed construction emergency large"),
        ("CAR", "car auto van vehicle"),
    )
    for word in words.split()
)
"""Groups of classes by parts of the datasets' and OpenSCENARIO's names; the first that a name has counts."""


def class_name(label: str) -> str:
    """Return a class in the singular and without its group: "Cone" for "Cones", "Pedicab" for "Other
    Vehicle - Pedicab"."""
    parts = [part.strip() for part in label.split(" - ") if part.strip()] or ["Actor"]
    name = parts[-1] if parts[-1].lower() not in VAGUE else parts[0]
    last = name.split()[-1].lower()
    plural = last.endswith("s") and not last.endswith(("ss", "us", "is"))
    return name[:-1] if plural else name


def plain_names(actors: Mapping[str, Actor]) -> dict[str, str]:
    """Return "class number" for each actor by id. Numbers count the actors of a class in the order of their ids, so
    they are the same whenever a log is read."""
    counts: Counter[str] = Counter()
    names = {}
    for uid in sorted(actors):
        name = class_name(actors[uid].label)
        counts[name] += 1
        names[uid] = f"{name} {counts[name]}"
    return names


def full_name(plain: str, word: str) -> str:
    """Return a name with the word for the colour, where there is one."""
    return f"{plain}, {word}" if word else plain


def readable_names(actors: Mapping[str, Actor], words: Mapping[str, str]) -> dict[str, str]:
    """Return the names of actors by id, with the words for their colours by id as far as these are known."""
    return {uid: full_name(plain, words.get(uid, "")) for uid, plain in plain_names(actors).items()}


def group_of(label: str) -> str:
    """Return the group of a class: "CAR", "TRUCK", "PERSON", "CYCLE" or "OTHER"."""
    if motion_of(label) == "still":
        return "OTHER"
    words = label.lower()
    return next((group for group, word in GROUP_WORDS if word in words), "OTHER")
