"""Renderers of a simulation's menu."""

from __future__ import annotations

from unisim_blender.core.prepare.renderers import RENDERERS
from unisim_blender.editing.simulation.menus import AUTO, RENDERER_ITEMS, renderer_options


def test_the_menu_has_renderers_of_the_command_line() -> None:
    """Files keep the numbers."""
    assert [(name, number) for name, _, _, number in RENDERER_ITEMS] == [
        (AUTO, 0),
        ("surfel", 1),
        ("warp", 2),
        ("street", 3),
    ]
    assert {name for name, *_ in RENDERER_ITEMS[1:]} <= set(RENDERERS.with_plugins())


def test_options_of_a_renderer() -> None:
    assert renderer_options("street") == ["--renderer", "street"]
    assert renderer_options(AUTO) == renderer_options("") == []
