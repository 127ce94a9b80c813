"""Translations of the interface: a JSON file a language, and functions for strings that are put together at run time.

Blender itself translates labels and descriptions of registered classes, constant texts of layouts, and constant
reports. Strings with values are translated here before the values go in.
"""

from __future__ import annotations

import json
from pathlib import Path

import bpy

from ..editing.texts import text_of, translated

TABLES: dict[str, dict[str, str]] = {
    path.stem: json.loads(path.read_text(encoding="utf-8")) for path in Path(__file__).parent.glob("*.json")
}
"""English texts and their translations, by Blender's name of the language: a file each."""
CONTEXTS = ("*", "Operator")
"""Blender's contexts: of labels and descriptions, and of operators' names."""


def localized(text: str) -> str:
    """Return a `Text` in the user's language, any other string, as the name of an object, as it is."""
    return translated(text, bpy.app.translations.pgettext_iface)


def interface(text: str, /, **values: object) -> str:
    """Return a text of the interface in the user's language, with ``values`` in its braces; those that are texts, too."""
    return translated(text_of(text, values), bpy.app.translations.pgettext_iface)


def tooltip(text: str, /, **values: object) -> str:
    """Return a tooltip in the user's language, with ``values`` in its braces; those that are texts, too."""
    return translated(text_of(text, values), bpy.app.translations.pgettext_tip)


def message(text: str, /, **values: object) -> str:
    """Return a report or a line of status in the user's language, with ``values`` in its braces; those that are texts,
    too."""
    return translated(text_of(text, values), bpy.app.translations.pgettext_rpt)


def table(texts: dict[str, str]) -> dict[tuple[str, str], str]:
    """Return a language's table as Blender takes it: by context and English text."""
    return {(context, english): translated for context in CONTEXTS for english, translated in texts.items()}


def register() -> None:
    """Give Blender the tables."""
    bpy.app.translations.register(__package__, {language: table(texts) for language, texts in TABLES.items()})


def unregister() -> None:
    """Take them away again."""
    bpy.app.translations.unregister(__package__)
