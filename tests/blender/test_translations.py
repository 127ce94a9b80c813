"""The interface's texts: ready for translation, and written alike."""

from __future__ import annotations

import importlib.util
import json
import re
import string
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import pytest

from unisim_blender import translations
from unisim_blender.bridge.changes.muting import mute
from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.sampling.edit_list import muted_lines, read_now
from unisim_blender.editing.texts import Text, translated, unpacked
from unisim_blender.features.edits.panel import count_text
from unisim_blender.translations import TABLES, interface, localized, message, table

ROOT = Path(__file__).parents[2]
ABBREVIATED = ("accel.", "curv.")


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
        "{what}: cancel it or wait until it ends",
        "Save the .blend first, or choose a folder that does not depend on it",
    ):
        assert text in found, text


@pytest.mark.parametrize("language", TABLES)
def test_a_table_has_each_text_once(language: str) -> None:
    path = Path(translations.__file__).parent / f"{language}.json"
    pairs = json.loads(path.read_text(encoding="utf-8"), object_pairs_hook=list)
    assert [english for english, _ in pairs] == sorted({english for english, _ in pairs})


@pytest.mark.parametrize("language", TABLES)
def test_no_translation_is_of_a_text_that_is_gone(tool: Any, language: str) -> None:
    assert tool.stale(language) == []


@pytest.mark.parametrize("language", TABLES)
def test_translations_take_the_same_values(language: str) -> None:
    for english, german in TABLES[language].items():
        assert german.strip() and fields(english) == fields(german), english


@pytest.mark.parametrize("language", TABLES)
def test_every_text_is_translated(tool: Any, language: str) -> None:
    assert tool.lacking(language) == []


def test_texts_are_one_line(tool: Any) -> None:
    """A docstring of two lines would be a tooltip with the second one indented."""
    assert [text for text in tool.texts() if "\n" in text] == []


def test_texts_without_a_translation_stay_as_they_are() -> None:
    assert message("Warnings: {count}", count=3) == "Warnings: 3"
    assert interface("Actors: {actors}, sensors: {sensors}", actors=2, sensors=1) == "Actors: 2, sensors: 1"
    assert table({"Output": "Ausgabe"}) == {("*", "Output"): "Ausgabe", ("Operator", "Output"): "Ausgabe"}


def test_tooltips_are_one_sentence_without_a_period_and_use_the_fields_words(tool: Any) -> None:
    old = {"look", "looks", "picture", "pictures", "ways", "one's"}
    for text in tool.texts():
        assert not text.endswith(".") or text.endswith("…") or text in ABBREVIATED, text
        assert ". " not in text, text
        plain = re.sub(r"look None|looks? (through|from|beside|{)", "", text.lower())  # what cameras do
        words = set(plain.replace("look none", "").replace(":", " ").replace(",", " ").split())
        assert not words & old, text


def test_no_text_is_put_together_without_its_translation(tool: Any) -> None:
    """A string with values that a layout, a report or a status line is given in place has words in no other language."""
    assert list(tool.untold()) == []


def test_texts_in_texts_are_german_and_names_as_they_are() -> None:
    """Braces in names are no placeholders."""
    words = TABLES["de_DE"]
    text = Text(
        "Muted: {what} ({who})", what=Text("Moved {by}", by=Text("{length} left", length="3.0 m")), who="Camera {x}"
    )
    assert translated(text, words.__getitem__) == "Stummgeschaltet: Verschoben: 3.0 m nach links (Camera {x})"


@pytest.fixture
def in_german(monkeypatch: pytest.MonkeyPatch) -> None:
    """Texts are looked up in the German table; Blender's module, unlike Blender, has no languages that it could be set
    to."""

    def looked_up(english: str) -> str:
        return TABLES["de_DE"].get(english, english)

    lookups = dict.fromkeys(("pgettext_iface", "pgettext_tip", "pgettext_rpt"), looked_up)
    app = SimpleNamespace(translations=SimpleNamespace(**lookups))
    monkeypatch.setattr(translations, "bpy", SimpleNamespace(app=app))


def test_edits_and_warnings_are_german(in_german: None, street: Any) -> None:
    """Read lines, muted ones and warnings that the file keeps, as the panels show them."""
    actor = next(obj for obj in street.objects if obj.unisim.kind == "ACTOR" and not obj.unisim.mesh)
    actor.location.z += 20.0
    bpy.context.view_layer.update()
    line = next(line for line in read_now(street) if line.object_name == actor.name)
    assert line.what == "Moved 20.0 m up" and localized(line.what) == "Verschoben: 20.0 m nach oben"
    assert bpy.ops.unisim.check() == {"FINISHED"}
    warning = next(one for one in street.unisim_check.warnings if one.text.endswith("above the ground"))
    assert localized(unpacked(warning.text_parts, warning.text)).endswith("m über dem Boden")
    mute(street, source_of(street), line)
    (muted,) = muted_lines(street)
    assert muted.what == "Moved 20.0 m up" and localized(muted.what) == "Verschoben: 20.0 m nach oben"
    assert count_text(tuple(muted_lines(street))) == "1 Änderung, 1 stummgeschaltet"
