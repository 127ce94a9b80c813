"""Conditions that operators need, with sentences, so that a greyed button says why it is grey."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from ...translations import tooltip
from ..objects.imported import imported_objects
from .selection import chosen

Need = tuple[object, str]
"""Whether a need is met, and the sentence that says what to do where it is not."""


def allowed(operator: Any, *needs: Need) -> bool:
    """Return whether all needs are met; the first that is not is what the button's tooltip says."""
    for met, sentence in needs:
        if not met:
            operator.poll_message_set(tooltip(sentence))
            return False
    return True


def folder_on_disk(stated: str) -> Path | None:
    """Return the folder that a setting states, absolute; None where it states none, or one beside a .blend that was
    never saved."""
    if not stated or (stated.startswith("//") and not bpy.data.filepath):
        return None
    return Path(bpy.path.abspath(stated)).absolute()


def drive(context: bpy.types.Context) -> Need:
    """A drive has been imported."""
    return context.scene.unisim.log, "Import a driving log or a trained scene first"


def object_mode(context: bpy.types.Context) -> Need:
    """The window is in Object Mode."""
    return context.mode == "OBJECT", "Switch to Object Mode first (Tab)"


def vehicle(context: bpy.types.Context) -> Need:
    """The ego vehicle is there."""
    return next(imported_objects(context.scene, "EGO"), None), "Import a drive first: there is no ego vehicle"


def selected(context: bpy.types.Context, sentence: str, *kinds: str) -> Need:
    """Something of some kinds is selected."""
    return chosen(context, *kinds), sentence


def idle(running: object) -> Need:
    """Nothing runs in the background."""
    return not running, "Another task is running: cancel it or wait until it ends"
