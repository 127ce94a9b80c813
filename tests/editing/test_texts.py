"""Texts that are put together of a sentence and values: English strings that can be told in another language."""

import copy
import pickle

from unisim_blender.editing.texts import (
    LOWER,
    UPPER,
    Text,
    cased,
    counted,
    free_name,
    packed,
    series,
    translated,
    unpacked,
)


def test_a_text_is_its_english_string() -> None:
    far = Text("{length:.1f} m to the left", length=2.0)
    text = series([Text("Moved {by}", by=far), cased(Text("Retimed: {time} later", time="0.5 s"), LOWER)], "; ")
    assert text == "Moved 2.0 m to the left; retimed: 0.5 s later" and isinstance(text, str)
    assert text == copy.deepcopy(text) == pickle.loads(pickle.dumps(text))
    assert [counted(n, "1 edit", "{count} edits") for n in (0, 1, 2)] == ["0 edits", "1 edit", "2 edits"]


def test_texts_are_told_in_another_language_with_all_their_parts() -> None:
    """Braces in names are no placeholders, and a name is not translated."""
    words = {
        "{what} of {who}": "{who}: {what}",
        "Moved {by}": "Verschoben: {by}",
        "{length} left": "{length} nach links",
        "Retimed: {time} later": "Um {time} verzögert",
    }
    text = Text("{what} of {who}", what=Text("Moved {by}", by=Text("{length} left", length="3.0 m")), who="Camera {x}")
    for one in (text, copy.deepcopy(text), pickle.loads(pickle.dumps(text)), unpacked(packed(text), str(text))):
        assert translated(one, words.__getitem__) == "Camera {x}: Verschoben: 3.0 m nach links"
    retimed = Text("Retimed: {time} later", time="0.5 s")
    assert translated(cased(retimed, LOWER), words.__getitem__) == "um 0.5 s verzögert"
    assert translated(cased("ein Satz", UPPER), str) == "Ein Satz"
    assert translated("Moved {by}", words.__getitem__) == "Moved {by}"


def test_what_a_file_keeps_of_a_text_is_read_again_or_left() -> None:
    """Files of earlier versions keep the English string alone."""
    text = Text("is scaled by {factors}, beyond {least:g} to {most:g}", factors="3", least=0.5, most=2.0)
    again = unpacked(packed(text), str(text))
    assert isinstance(again, Text) and again == text and again.values == text.values
    assert packed("a name") == ""
    for parts in ("", "no JSON", "[1]", "{}", '{"text": "{0}", "values": {}, "case": ""}', packed(Text("Moved"))):
        found = unpacked(parts, str(text))
        assert found == text and not isinstance(found, Text)


def test_a_name_that_is_taken_has_a_number() -> None:
    assert free_name("speed", ()) == "speed" and free_name("speed", {"speed", "speed 2"}) == "speed 3"
    assert free_name("roof", {"roof", "roof_2"}, "_") == "roof_3"
