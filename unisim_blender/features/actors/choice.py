"""Actors to choose from by their thumbnails: what Replace Appearance and Insert Actor show."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from ...bridge.objects.source import source_of
from ...core.actor_images.names import group_of, readable_names
from ...core.errors import UnisimError
from ...core.model.scene_file import HEADER_NAME, read_scene_header
from ...core.world.drive import Actor
from ...editing.actors.entries import class_and_size, natural
from ...editing.actors.table import named_actors
from ...translations import interface
from . import thumbnails

PAGE = 32
"""Thumbnails in one grid: what fits the window."""
ICON_SCALE, GRID_SCALE = 8.0, 5.0
"""Edges of the chosen actor's thumbnail and of those in the grid, in widget units."""

ActorChoice = tuple[str, str, str, int, int]
NONE: list[ActorChoice] = [("", "None", "There is no such actor", 0, 0)]
_texts: dict[str, str] = {}
"""Every text that a menu has shown: Blender keeps where it lies, and not the text."""


@dataclass(frozen=True)
class Choice:
    """The actors that can be chosen, by id: those of a trained scene in a folder, or of the drive itself
    where that is None."""

    actors: dict[str, Actor]
    names: dict[str, str]
    log_path: Path
    scene_path: Path | None


_headers: dict[Path, tuple[float, Any]] = {}
"""Headers of trained scenes, with the time of their last change."""


def choice_of(context: bpy.types.Context, folder: str) -> Choice:
    """Return the actors of the trained scene in a folder, or of the imported drive where that is "".
    Raises `UnisimError`."""
    if not folder:
        source = source_of(context.scene)
        log_path, scene_path, actors = (
            thumbnails.log_of(context.scene),
            thumbnails.scene_of(context.scene),
            source.drive.actors,
        )
        counted = named_actors(source)
    else:
        scene_path = Path(bpy.path.abspath(folder))
        header = header_of(scene_path)
        log_path, actors = (scene_path / header.log_path).resolve(), header.drive.actors
        counted = actors
    thumbnails.ask(log_path)
    words = {uid: one.word for uid, one in thumbnails.images_of(log_path).items()}
    names = readable_names(counted, words)
    return Choice(actors, {uid: names[uid] for uid in actors}, log_path, scene_path)


def header_of(scene_path: Path) -> Any:
    """Return a trained scene's header, read again only where it has changed."""
    changed = (scene_path / HEADER_NAME).stat().st_mtime
    if scene_path not in _headers or _headers[scene_path][0] != changed:
        _headers[scene_path] = changed, read_scene_header(scene_path)
    return _headers[scene_path][1]


def listed(choice: Choice, group: str) -> list[str]:
    """Return the ids of the actors of a group, or of "ALL", in the order of their names."""
    found = [uid for uid, actor in choice.actors.items() if group in ("ALL", group_of(actor.label))]
    return sorted(found, key=lambda uid: natural(choice.names[uid]))


def items_of(context: bpy.types.Context, folder: str, group: str, page: int) -> list[ActorChoice]:
    """Return the actors of a group for a menu with thumbnails; ``page`` 1, 2, … has `PAGE` of them, 0 has all."""
    try:
        choice = choice_of(context, folder)
    except (UnisimError, OSError):
        return NONE
    numbers = {uid: number + 1 for number, uid in enumerate(sorted(choice.actors))}
    found = listed(choice, group)
    found = found[(page - 1) * PAGE : page * PAGE] if page else found
    return [
        (
            lasting(uid),
            lasting(choice.names[uid]),
            lasting(class_and_size(choice.actors[uid])),
            icon_of(choice, uid),
            numbers[uid],
        )
        for uid in found
    ] or NONE


def lasting(text: str) -> str:
    """Return the same text as an object that stays."""
    return _texts.setdefault(text, text)


def icon_of(choice: Choice, uid: str) -> int:
    """Return an actor's thumbnail."""
    return thumbnails.icon_of(choice.log_path, uid, choice.scene_path)


def pages(context: bpy.types.Context, folder: str, group: str) -> int:
    """Return how many grids the actors of a group take."""
    try:
        return max(1, -(-len(listed(choice_of(context, folder), group)) // PAGE))
    except (UnisimError, OSError):
        return 1


def draw_choice(layout: bpy.types.UILayout, context: bpy.types.Context, operator: Any, folder: str) -> None:
    """Draw class, page, the chosen actor's thumbnail, which opens the grid of all, and what it is."""
    row = layout.row(align=True)
    row.prop(operator, "group", text="")
    count = pages(context, folder, operator.group)
    part = row.row(align=True)
    part.enabled = count > 1
    part.prop(operator, "page", text=interface("Page (of {count})", count=count), translate=False)
    layout.template_icon_view(operator, "appearance", show_labels=True, scale=ICON_SCALE, scale_popup=GRID_SCALE)
    try:
        choice = choice_of(context, folder)
    except (UnisimError, OSError) as fault:
        layout.label(text=str(fault), icon="ERROR")
        return
    known = operator.appearance in choice.actors
    layout.label(text=choice.names[operator.appearance] if known else "Click the image to choose")
    layout.label(text=class_and_size(choice.actors[operator.appearance]) if known else "")


def first_of(context: bpy.types.Context, folder: str, group: str, page: int) -> str:
    """Return the first actor of a page; "" where it has none."""
    return items_of(context, folder, group, page)[0][0]
