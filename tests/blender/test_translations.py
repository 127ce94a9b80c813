"""The interface's texts: ready for translation, and written alike."""

from __future__ import annotations

import copy
import importlib.util
import pickle
import re
import string
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import pytest

from unisim_blender import translations
from unisim_blender.bridge.changes.muting import mute
from unisim_blender.bridge.objects.source import source_of
from unisim_blender.bridge.sampling.edit_list import muted_lines, read_now
from unisim_blender.editing.texts import LOWER, Text, cased, counted, packed, series, told, unpacked
from unisim_blender.panels.edits import count_text
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
    """An operator's name and tooltip, a panel, a setting, an item of a menu, a label, a report, why a button is grey."""
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
        told = re.sub(r"look None|looks? (through|from|beside|{)", "", text.lower())  # what cameras do
        words = set(told.replace("look none", "").replace(":", " ").replace(",", " ").split())
        assert not words & old, text


def test_no_text_is_put_together_without_its_translation(tool: Any) -> None:
    """A string with values that a layout, a report or a status line is given in place has words in no other language."""
    assert list(tool.untold()) == []


def test_a_text_is_its_english_string() -> None:
    far = Text("{length:.1f} m to the left", length=2.0)
    text = series([Text("Moved {by}", by=far), cased(Text("Retimed: {time} later", time="0.5 s"), LOWER)], "; ")
    assert text == "Moved 2.0 m to the left; retimed: 0.5 s later" and isinstance(text, str)
    assert text == copy.deepcopy(text) == pickle.loads(pickle.dumps(text))
    assert [counted(n, "1 edit", "{count} edits") for n in (0, 1, 2)] == ["0 edits", "1 edit", "2 edits"]


def test_texts_are_told_in_another_language_with_all_their_parts() -> None:
    """Braces in names are no placeholders, and a name is not translated."""
    words = TABLES["de_DE"]
    name = "Camera {x}"
    text = Text("Muted: {what} ({who})", what=Text("Moved {by}", by=Text("{length} left", length="3.0 m")), who=name)
    for one in (text, copy.deepcopy(text), pickle.loads(pickle.dumps(text)), unpacked(packed(text), str(text))):
        assert told(one, lambda english: words.get(english, english)) == (
            "Stummgeschaltet: Verschoben: 3.0 m nach links (Camera {x})"
        )
    last = cased(Text("Retimed: {time} later", time="0.5 s"), LOWER)
    assert told(last, lambda english: words[english]) == "zeitlich verschoben: 0.5 s später"
    assert told("Camera", lambda english: words[english]) == "Camera"


def test_what_a_file_keeps_of_a_text_is_read_again_or_left() -> None:
    """Files of earlier versions keep the English string alone."""
    text = Text("is scaled by {factors}, beyond {least:g} to {most:g}", factors="3", least=0.5, most=2.0)
    again = unpacked(packed(text), str(text))
    assert isinstance(again, Text) and again == text and again.values == text.values
    assert packed("a name") == ""
    for parts in ("", "no JSON", "[1]", "{}", '{"text": "{0}", "values": {}, "case": ""}', packed(Text("Moved"))):
        found = unpacked(parts, str(text))
        assert found == text and not isinstance(found, Text)


@pytest.fixture
def in_german(monkeypatch: pytest.MonkeyPatch) -> None:
    """Texts are looked up in the German table; Blender's module, unlike Blender, has no languages that it could be set to."""

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
