"""List the interface's texts, and those that a language has no translation for.

python tools/translations.py [LANGUAGE]      (LANGUAGE: de_DE; without: all texts)
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "unisim_blender"
KINDS = ("Operator", "Panel", "Menu", "PropertyGroup", "AddonPreferences", "FileHandler")
CALLS = {
    "interface": 1, "tooltip": 1, "message": 1, "label": 0, "operator": 0, "operator_menu_enum": 0, "prop": 0,
    "menu": 0,
    "progress": 0, "report": 2, "row_of": 2, "allowed": 9, "selected": 1, "Text": 1, "counted": 3, "translatable": 1,
    "Slot": 2, "optional_row": 3, "text_row": 2,
}  # fmt: skip
"""Functions whose constant texts people see, and how many of their positional arguments may be such texts."""

SHOWN = {
    "label", "operator", "prop", "menu", "progress", "report", "row_of", "say", "status_text_set", "header_text_set",
    "invoke_confirm", "poll_message_set",
}  # fmt: skip
"""Functions that show a text to people, translated or not."""
NEEDS = ("window.py", "background.py")
"""Files beside those of `features` that say what a button needs."""
LONGEST_UNIT = 2
"""Letters of a unit: km, dB. Longer words are language."""


def ours(kind: str) -> Iterator[Any]:
    """Yield the registered classes of a kind that are this package's."""
    waiting = list(getattr(bpy.types, kind).__subclasses__())
    while waiting:
        cls = waiting.pop()
        waiting += cls.__subclasses__()
        if cls.__module__.startswith("unisim_blender") and hasattr(cls, "bl_rna") and cls.is_registered:
            yield cls


def registered_texts() -> Iterator[str]:
    """Yield labels and descriptions of the package's classes and of their properties, as Blender looks them up."""
    for kind in KINDS:
        for cls in ours(kind):
            rna: Any = cls.bl_rna
            if kind == "Operator":
                rna = getattr(bpy.ops.unisim, cls.bl_idname.partition(".")[2]).get_rna_type()
            if kind in ("Operator", "Panel", "Menu"):
                yield rna.name if kind == "Operator" else cls.bl_label
            if kind in ("Operator", "Menu"):
                yield rna.description if kind == "Operator" else cls.bl_description
            for name, prop in rna.properties.items():
                if name in bpy.types.Operator.bl_rna.properties or name in bpy.types.PropertyGroup.bl_rna.properties:
                    continue
                if name not in cls.__annotations__ and not any(
                    name in base.__dict__.get("__annotations__", {}) for base in cls.__mro__
                ):
                    continue
                if "HIDDEN" not in prop.tags and not prop.is_hidden:
                    yield from texts_of(name, prop)
    for owner in (bpy.types.WindowManager, bpy.types.Scene, bpy.types.Object):
        for name, prop in owner.bl_rna.properties.items():
            if name.startswith("unisim_") and prop.name != name:  # the others are in no layout
                yield from texts_of(name, prop)


def texts_of(name: str, prop: Any) -> Iterator[str]:
    """Yield a property's name, its description, and those of its items."""
    yield from (prop.name if prop.name != name else "", prop.description)
    if prop.type == "ENUM":
        for item in prop.enum_items:
            yield from (item.name, item.description)


def sources() -> list[Path]:
    """Return the files that have texts."""
    folders = ("operators", "panels", "features", "viewport", "process", "bridge", "editing")
    return [*PACKAGE.glob("*.py"), *(path for folder in folders for path in sorted((PACKAGE / folder).rglob("*.py")))]


def written_texts() -> Iterator[str]:
    """Yield constant texts of layouts, reports, and conditions of buttons."""
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                yield from _called(node)
            elif (
                isinstance(node, ast.Return | ast.Assign)
                and (path.is_relative_to(PACKAGE / "features") or path.name in NEEDS)
                and isinstance(node.value, ast.Tuple)
            ):
                yield from (text for text in _constants(node.value.elts[-1]) if " " in text)  # a need of a button
            elif isinstance(node, ast.Lambda) and isinstance(node.body, ast.Tuple):
                yield from (text for text in _constants(node.body) if " " in text)


def untold() -> Iterator[str]:
    """Yield where a call that shows a text is given a string with values and words of its own, which no table can
    have."""
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or _name(node) not in SHOWN:
                continue
            for argument in [*node.args, *(k.value for k in node.keywords if k.arg in ("text", "message"))]:
                parts = [part for part in ast.walk(argument) if isinstance(part, ast.JoinedStr)]
                words = [one.value for part in parts for one in part.values if isinstance(one, ast.Constant)]
                if any(len(word) > LONGEST_UNIT for text in words for word in re.findall("[^\\W\\d_]+", str(text))):
                    yield f"{path.relative_to(ROOT)}:{node.lineno}"


def _name(node: ast.Call) -> str:
    function = node.func
    return (
        function.id if isinstance(function, ast.Name) else function.attr if isinstance(function, ast.Attribute) else ""
    )


def _called(node: ast.Call) -> Iterator[str]:
    count = CALLS.get(_name(node))
    if count is None or any(k.arg == "translate" for k in node.keywords):
        return
    for argument in [*node.args[:count], *(k.value for k in node.keywords if k.arg in ("text", "sentence"))]:
        yield from _constants(argument)


def _constants(node: ast.AST) -> Iterator[str]:
    """Yield the constant texts of an argument: it itself, the sides of a condition, the sentence of a pair."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str) and is_text(node.value):
        yield node.value
    elif isinstance(node, ast.IfExp):
        yield from (*_constants(node.body), *_constants(node.orelse))
    elif isinstance(node, ast.BoolOp):
        for value in node.values:
            yield from _constants(value)
    elif isinstance(node, ast.Tuple):
        yield from _constants(node.elts[-1])


def is_text(value: str) -> bool:
    """Whether a string is more than a name that is the same in every language."""
    if re.fullmatch(r"[a-z0-9_]+\.[a-z0-9_]+", value):  # an operator's id
        return False
    return any(letter.islower() for letter in value) or (" " in value and any(letter.isalpha() for letter in value))


def texts() -> set[str]:
    """Return all texts of the interface, in English."""
    return {text for text in (*registered_texts(), *written_texts()) if is_text(text)}


def lacking(language: str) -> list[str]:
    """Return the texts that a language's table has no translation for."""
    from unisim_blender.translations import TABLES

    return sorted(texts() - set(TABLES[language]))


def stale(language: str) -> list[str]:
    """Return what a language's table translates that the interface does not say any more."""
    from unisim_blender.translations import TABLES

    return sorted(set(TABLES[language]) - texts())


def main(language: str = "") -> None:
    """Print texts."""
    import unisim_blender

    unisim_blender.register()
    try:
        if not language:
            print("\n".join(sorted(texts())))
            return
        print(*(f"untranslated: {text}" for text in lacking(language)), sep="\n")
        print(*(f"stale: {text}" for text in stale(language)), sep="\n")
        print(f"{len(texts()) - len(lacking(language))} of {len(texts())} texts are translated")
    finally:
        unisim_blender.unregister()


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    main(*sys.argv[1:])
