"""The interface's texts: ready for translation, and written alike."""

from __future__ import annotations

import importlib.util
import string
from pathlib import Path
from typing import Any

import pytest

from unisim_blender.translations import TABLES, interface, message, table

ROOT = Path(__file__).parents[2]


@pytest.fixture
def tool(addon: Any) -> Any:
    """tools/translations.py."""
    spec = importlib.util.spec_from_file_location("translations_tool", ROOT / "tools" / "translations.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def fields(text: str) -> set[str]:
    """Names of the values that go into a text, with their formats."""
    return {f"{name}:{kind}" for _, name, kind, _ in string.Formatter().parse(text) if name}


def test_the_tool_finds_texts_of_every_kind(tool: Any) -> None:
    """An operator's name and tooltip, a panel, a setting, an item of a menu, a label, a report, why
    a button is grey."""
    found = tool.texts()
    for text in (
        "Render Sequence",
        "Duplicate the selected actors with their trajectories",
        "Output",
        "Contact shadows",
        "Next lane, left",
        "Not checked yet",
        "Warnings: {count}",
        "Select an actor first",
        "Another task is running: cancel it or wait until it ends",
        "Save the .blend first, or choose a folder that does not depend on it",
    ):
        assert text in found, text


@pytest.mark.parametrize("language", TABLES)
def test_no_translation_is_of_a_text_that_is_gone(tool: Any, language: str) -> None:
    assert tool.stale(language) == []


@pytest.mark.parametrize("language", TABLES)
def test_translations_take_the_same_values(language: str) -> None:
    for english, translated in TABLES[language].items():
        assert translated.strip() and fields(english) == fields(translated), english


def test_operators_and_panels_are_german(tool: Any) -> None:
    german = TABLES["de_DE"]
    names = [cls.bl_label for kind in ("Operator", "Panel") for cls in tool.ours(kind)]
    lacking = [name for name in names if name not in german]
    assert len(lacking) < 0.15 * len(names), lacking


def test_texts_without_a_translation_stay_as_they_are() -> None:
    assert message("Warnings: {count}", count=3) == "Warnings: 3"
    assert interface("Actors: {actors}, sensors: {sensors}", actors=2, sensors=1) == "Actors: 2, sensors: 1"
    assert table({"Output": "Ausgabe"}) == {("*", "Output"): "Ausgabe", ("Operator", "Output"): "Ausgabe"}


def test_tooltips_are_one_sentence_without_a_period_and_use_the_fields_words(tool: Any) -> None:
    old = {"look", "looks", "picture", "pictures", "ways", "one's"}
    for text in tool.texts():
        assert not text.endswith(".") or text.endswith("…"), text
        assert ". " not in text, text
        words = set(text.lower().replace(":", " ").replace(",", " ").split())
        assert not words & old or "look None" in text or "look through" in text.lower(), text
