"""Parameters of models as documents: read, checked, written; the schema says the same."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.simulation.actors import models
from unisim_blender.core.simulation.actors.model import (
    MODELS,
    ActorMotion,
    Model,
    model_from_dict,
    model_schema,
    models_schema,
    register,
)
from unisim_blender.core.simulation.actors.models import Idm, Scripted
from unisim_blender.core.simulation.actors.models.scripted import ScriptedKey

FILES = Path(str(models.__file__)).parent
EXAMPLES: dict[str, dict[str, Any]] = {
    "replay": {"gap_m": 1.5},
    "idm": {"headway_s": 1.0, "gap_m": 2.0, "exponent": 2},
    "auto": {"departure_m": 0.5, "horizon_s": 2.0},
    "lane": {"braking_m_s2": 3.0},
    "cut_in": {"cut_in_gap_m": 3.0, "cut_in_headway_s": 1.0, "duration_s": 2.5, "speed_difference_m_s": -3.0},
    "attack": {"best": 5, "range_m": 30.0, "neighbour_cost_m": 0.0},
    "scripted": {"keys": [{"time_s": 0.0, "speed_m_s": 3.0}, {"time_s": 2.0, "left_m": -1.0}]},
}


@pytest.fixture
def own_register() -> Iterator[None]:
    """What a test registers is taken back."""
    before = dict(MODELS)
    yield
    MODELS.clear()
    MODELS.update(before)


def test_each_file_is_one_model_and_each_model_one_line() -> None:
    lines = re.findall(r"^from \.(\w+) import (\w+) as \2$", (FILES / "__init__.py").read_text(), re.M)
    assert sorted(name for name, _ in lines) == sorted(
        path.stem for path in FILES.glob("*.py") if path.stem != "__init__"
    )
    assert [(kind.type, kind.__name__) for kind in MODELS.values()] == lines


@pytest.mark.parametrize("kind", MODELS.values(), ids=lambda kind: kind.type)
def test_a_model_is_read_and_written(kind: type[Model]) -> None:
    document = {"type": kind.type, **EXAMPLES[kind.type]}
    model = model_from_dict(document)
    assert type(model) is kind
    written = model.to_dict()
    assert {name: written[name] for name in document} == document
    assert model_from_dict(written) == model
    for schema in (model_schema(kind), models_schema()):
        jsonschema.Draft202012Validator.check_schema(schema)
        assert jsonschema.Draft202012Validator(schema).is_valid(document)
        assert jsonschema.Draft202012Validator(schema).is_valid(written)
    assert model_schema(kind)["description"].endswith(".")
    defaults = {field.name: field.default for field in fields(kind) if field.default is not MISSING}
    for name, value in defaults.items():
        assert written[name] == EXAMPLES[kind.type].get(name, value)


FAULTS: list[tuple[dict[str, Any], str]] = [
    ({"type": "idm", "headway_s": -1}, "a.headway_s: -1 is less than the minimum of 0"),
    ({"type": "idm", "gap_m": 0}, "a.gap_m: 0 is less than or equal to the minimum of 0"),
    ({"type": "idm", "acceleration_m_s2": 1e9}, "a.acceleration_m_s2: 1000000000.0 is greater than the maximum of 50"),
    ({"type": "idm", "gap_m": "2"}, "a.gap_m: '2' is not of type 'number'"),
    ({"type": "idm", "gap_m": True}, "a.gap_m: True is not of type 'number'"),
    ({"type": "attack", "best": 1.5}, "a.best: 1.5 is not of type 'integer'"),
    ({"type": "replay", "headway_s": 1}, "a: Additional properties are not allowed ('headway_s' was unexpected)"),
    ({"type": "scripted"}, "a: 'keys' is a required property"),
    ({"type": "scripted", "keys": []}, "a.keys: [] should be non-empty"),
    ({"type": "scripted", "keys": 3}, "a.keys: 3 is not of type 'array'"),
    ({"type": "scripted", "keys": [3]}, "a.keys[0]: 3 is not of type 'object'"),
    ({"type": "scripted", "keys": [{"speed_m_s": 3}]}, "a.keys[0]: 'time_s' is a required property"),
    ({"type": "scripted", "keys": [{"time_s": 0, "speed": 3}]},
     "a.keys[0]: Additional properties are not allowed ('speed' was unexpected)"),
    ({"type": "scripted", "keys": [{"time_s": 0, "speed_m_s": -3}]},
     "a.keys[0].speed_m_s: -3 is less than the minimum of 0"),
    ({"type": "drunk"}, "a.type: must be one of replay, idm, auto, lane, cut_in, attack, scripted, not 'drunk'"),
    ({}, "a.type: must be one of replay, idm, auto, lane, cut_in, attack, scripted, not None"),
]  # fmt: skip


@pytest.mark.parametrize(("document", "message"), FAULTS, ids=lambda value: value if isinstance(value, str) else "")
def test_a_fault_is_one_sentence_and_the_schema_finds_it_too(document: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        model_from_dict(document, "a")
    assert str(caught.value) == message
    assert not jsonschema.Draft202012Validator(models_schema()).is_valid(document)


def test_what_a_schema_cannot_say() -> None:
    late = {"type": "scripted", "keys": [{"time_s": 2, "left_m": 0}, {"time_s": 2, "left_m": 1}]}
    with pytest.raises(ScenarioError, match=r"^a\.keys\[1\]\.time_s: 2 must be later than 2$"):
        model_from_dict(late, "a")
    with pytest.raises(ScenarioError, match=r"^a\.keys\[0\]: needs speed_m_s or left_m$"):
        model_from_dict({"type": "scripted", "keys": [{"time_s": 2}]}, "a")
    with pytest.raises(ScenarioError, match=r"^a: must be an object, not \[\]$"):
        model_from_dict([], "a")


def test_parameters_are_checked_in_python_too() -> None:
    with pytest.raises(ScenarioError, match=r"^idm\.headway_s: nan is not of type 'number'$"):
        Idm(headway_s=math.nan)
    with pytest.raises(ScenarioError, match=r"^scripted\.keys\[0\]\.time_s: inf is not of type 'number'$"):
        Scripted((ScriptedKey(math.inf, 1.0),))


def test_what_is_no_model_is_not_registered(own_register: None) -> None:
    @dataclass(frozen=True)
    class Half(Idm):
        """A model whose schema lacks a member."""

        type = "half"
        members = Idm.members

        more: float = 1.0

    with pytest.raises(TypeError, match=r'model "half": members .* are not its fields'):
        register(Half)

    @dataclass(frozen=True)
    class Again(Idm):
        """A model whose name is taken."""

    with pytest.raises(ValueError, match="there is an actor model 'idm' already"):
        register(Again)
    assert MODELS["idm"] is Idm and ActorMotion is not None
