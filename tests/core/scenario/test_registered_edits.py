"""The edits that are registered: each is whole, in a file of its own; another one is read, checked and
applied as they are."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from pathlib import Path

import jsonschema
import pytest
from scenario.test_edits import edited
from scenario.test_scenario import EDITS as EXAMPLES
from turning_drive import turning_drive

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.scenario import edits, scenario_from_json, scenario_to_json
from unisim_blender.core.scenario.checks import require
from unisim_blender.core.scenario.context import EditContext, current
from unisim_blender.core.scenario.edit import EDITS, Edit, register
from unisim_blender.core.scenario.json_schema import NUMBER, TEXT
from unisim_blender.core.scenario.schema import edit_schema, scenario_schema
from unisim_blender.core.scenario.types import Scenario
from unisim_blender.core.world.drive import Drive

ROOT = Path(__file__).parents[3]
FILES = Path(str(edits.__file__)).parent


@pytest.fixture
def own_register() -> Iterator[None]:
    """What a test registers is taken back."""
    before = dict(EDITS)
    yield
    EDITS.clear()
    EDITS.update(before)


def test_each_file_is_one_edit_and_each_edit_one_line() -> None:
    lines = re.findall(r"^from \.(\w+) import (\w+) as \2$", (FILES / "__init__.py").read_text(), re.M)
    assert sorted(name for name, _ in lines) == sorted(
        path.stem for path in FILES.glob("*.py") if path.stem != "__init__"
    )
    assert [(kind.type, kind.__name__) for kind in EDITS.values()] == lines


@pytest.mark.parametrize("kind", EDITS.values(), ids=lambda kind: kind.type)
def test_an_edit_is_whole(kind: type[Edit]) -> None:
    """A frozen dataclass with a schema, words, an effect, an example in the reference, and a reader or a
    reason for none."""
    assert is_dataclass(kind) and not kind.__abstractmethods__
    schema = edit_schema(kind)
    jsonschema.Draft202012Validator.check_schema(schema)
    assert scenario_schema()["$defs"][kind.type] == schema
    assert set(schema["properties"]) == {"type", *kind.former_names, *(field.name for field in fields(kind))}
    assert schema["description"].endswith(".")
    assert any(example["type"] == kind.type for example in EXAMPLES)
    assert f'"type": "{kind.type}"' in (ROOT / "docs" / "reference" / "scenario.md").read_text()
    assert bool(kind.seen_by) != bool(kind.unseen_because)
    with pytest.raises(AttributeError):
        vars(kind)["__setattr__"](object.__new__(kind), fields(kind)[0].name, 1)


@pytest.mark.parametrize("kind", EDITS.values(), ids=lambda kind: kind.type)
def test_members_that_a_schema_asks_for_are_missed(kind: type[Edit]) -> None:
    example = next(example for example in EXAMPLES if example["type"] == kind.type)
    for name in (field.name for field in fields(kind) if field.default is MISSING):
        short = {key: value for key, value in example.items() if key != name}
        with pytest.raises(ScenarioError, match=rf"s\.json: edits\[0\]: '{name}' is a required property"):
            scenario_from_json({**BARE, "edits": [short]}, Path("s.json"))


@pytest.mark.parametrize("kind", [kind for kind in EDITS.values() if kind.former_names], ids=lambda kind: kind.type)
def test_a_member_is_read_by_its_former_name(kind: type[Edit]) -> None:
    """The schema, which editors check documents with, takes either name; the current one is written."""
    example = next(example for example in EXAMPLES if example["type"] == kind.type)
    current_of = kind.former_names
    earlier = {
        next((old for old, new in current_of.items() if new == key), key): value for key, value in example.items()
    }
    assert earlier != example
    scenario = scenario_from_json({**BARE, "edits": [earlier]})
    assert scenario == scenario_from_json({**BARE, "edits": [example]})
    assert scenario_to_json(scenario)["edits"] == [example]
    checked = jsonschema.Draft202012Validator(scenario_schema())
    neither = {key: value for key, value in example.items() if key not in current_of.values()}
    for edit, valid in ((example, True), (earlier, True), (earlier | example, False), (neither, False)):
        assert checked.is_valid({**BARE, "edits": [edit]}) == valid, edit


def test_a_member_under_both_names_is_one_sentence() -> None:
    edit = {"type": "swap", "actor": "a", "look": "b", "appearance": "b"}
    with pytest.raises(ScenarioError) as caught:
        scenario_from_json({**BARE, "edits": [{"type": "remove", "actor": "c"}, edit]}, Path("s.json"))
    assert str(caught.value) == 's.json: edits[1]: has "appearance" and its former name "look": give one of them'


BARE = {"format": "unisim-scenario", "version": 1, "name": "s", "log": "l"}


def test_another_edit_is_read_checked_applied_and_written(own_register: None) -> None:
    @register
    @dataclass(frozen=True)
    class Raise(Edit):
        """The actor is higher."""

        type = "raise"
        members = {"actor": TEXT, "up_m": NUMBER}

        actor: str
        up_m: float = 1.0

        def check(self, scenario: Scenario, place: str) -> None:
            require(self.up_m > 0, f"{place}.up_m", f"must be above 0, not {self.up_m}")

        def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
            actor = current(drive, self.actor, f"{place}.actor", context)
            trajectory = actor.world_from_actor
            higher = replace(trajectory, positions=trajectory.positions + [0.0, 0.0, self.up_m])
            return replace(drive, actors={**drive.actors, actor.uid: replace(actor, world_from_actor=higher)})

    written = {"type": "raise", "actor": "car", "up_m": 2.5}
    document = {**BARE, "edits": [written]}
    scenario = scenario_from_json(document)
    assert scenario.edits == (Raise("car", 2.5),)
    assert scenario_to_json(scenario) == document
    recorded = turning_drive()
    now = edited(written, drive=recorded)
    assert now.actors["van"] is recorded.actors["van"]
    apart = now.actors["car"].world_from_actor.positions - recorded.actors["car"].world_from_actor.positions
    assert (apart == [0.0, 0.0, 2.5]).all()
    for edit, problem in (
        ({"type": "raise"}, "edits[0]: 'actor' is a required property"),
        ({"type": "raise", "actor": "car", "up_m": "2"}, "edits[0].up_m: '2' is not of type 'number'"),
        (
            {"type": "raise", "actor": "car", "up": 2},
            "edits[0]: Additional properties are not allowed ('up' was unexpected)",
        ),
        ({"type": "raise", "actor": "car", "up_m": -1}, "edits[0].up_m: must be above 0, not -1"),
    ):
        with pytest.raises(ScenarioError) as caught:
            scenario_from_json({**BARE, "edits": [edit]}, Path("s.json"))
        assert str(caught.value) == f"s.json: {problem}"
    del EDITS["raise"]
    with pytest.raises(ScenarioError, match=r"edits\[0\]\.type: 'raise' is not one of"):
        scenario_from_json(document)


def test_what_is_no_edit_is_not_registered(own_register: None) -> None:
    @dataclass(frozen=True)
    class Half(Edit):
        """An edit whose schema lacks a member."""

        type = "half"
        members = {"actor": TEXT}

        actor: str
        more: float

        def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
            return drive

    with pytest.raises(TypeError, match=r'edit "half": members \[\'actor\'\] are not its fields'):
        register(Half)
    Half.type, Half.members = "remove", {"actor": TEXT, "more": NUMBER}
    with pytest.raises(ValueError, match="there is an edit 'remove' already"):
        register(Half)
    assert EDITS["remove"] is edits.Remove
    Half.type, Half.former_names = "half", {"who": "whom"}
    with pytest.raises(TypeError, match=r'edit "half": former names {\'who\': \'whom\'} do not lead to its members'):
        register(Half)
