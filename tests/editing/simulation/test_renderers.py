"""Which renderers a simulation's menu has, by the log."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from unisim_blender.core.prepare.renderers import RENDERERS
from unisim_blender.editing.simulation.menus import AUTO, RECIPE_FILE, renderer_items, renderer_options
from unisim_street.street import RECIPE_FILE as WRITTEN
from unisim_street.street import build_street, recipe_document


def test_a_street_has_its_exact_sensors(tmp_path: Path) -> None:
    """A street that the exact engine drew, and nothing else; each of them is one that the command line has."""
    assert RECIPE_FILE == WRITTEN
    recipe = recipe_document(build_street(3, 3, 64, 36, ("front_camera",), 0.0).recipe)
    (tmp_path / RECIPE_FILE).write_text(json.dumps(recipe))
    names = [name for name, *_ in renderer_items(str(tmp_path))]
    assert names == [AUTO, "surfel", "warp", "street"] and set(names[1:]) <= set(RENDERERS.with_plugins())
    assert renderer_items(str(tmp_path)) is renderer_items(str(tmp_path))


@pytest.mark.parametrize("recipe", [None, "[1", "[]", '{"engine": "cycles"}'])
def test_other_logs_have_none(tmp_path: Path, recipe: str | None) -> None:
    if recipe is not None:
        (tmp_path / RECIPE_FILE).write_text(recipe)
    assert [(name, number) for name, _, _, number in renderer_items(str(tmp_path))] == [
        (AUTO, 0),
        ("surfel", 1),
        ("warp", 2),
    ]
    assert len(renderer_items("")) == 3


def test_options_of_a_renderer() -> None:
    """One that a scene keeps and its log does not have is "" for Blender."""
    assert renderer_options("street") == ["--renderer", "street"]
    assert renderer_options(AUTO) == renderer_options("") == []
