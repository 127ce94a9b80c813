"""What a view draws over itself, and whether its controls stay where they are, in windows of two sizes. Run by `run.py`.

`UNISIM_UI_WINDOW=800x600` opens a small window."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from buttons import Place, buttons, region_of
from hands import key, middle, to
from session import area, choose, redraw, results, screenshot, start, view, wait_for_image
from tasks import imported, task


def options(**values: object) -> None:
    """Set the view's options of rendered images."""
    with bpy.context.temp_override(area=area("VIEW_3D"), space_data=view()[1]):
        for name, value in values.items():
            setattr(bpy.context.window_manager.unisim_view, name, value)


def header(into: dict[str, list[Place]]) -> Iterator[float]:
    """Note the buttons of the view's header."""
    yield from buttons(area("VIEW_3D"), "HEADER", into, tuple(0.3 + 0.005 * column for column in range(140)))


def steady_header() -> Iterator[float]:
    """No button of the view's header moves with shading."""
    first: dict[str, list[Place]] = {}
    yield from header(first)
    results["header"] = {name: places[0] for name, places in first.items()}
    for shading in ("MATERIAL", "RENDERED", "SOLID"):
        view()[1].shading.type = shading
        yield 1.0
        screenshot(f"overview_{shading.lower()}")
        now: dict[str, list[Place]] = {}
        yield from header(now)
        moved = {name: (places, now.get(name)) for name, places in first.items() if now.get(name) != places}
        assert not moved, f"with shading {shading} buttons are elsewhere: {moved}"


def overlaid() -> Iterator[float]:
    """Speed graph, presence timeline, split line and notices on a white ground, at once."""
    scene, space = bpy.context.scene, view()[1]
    actors = [one for one in scene.objects if one.unisim.kind == "ACTOR" and one.parent is not None]
    choose(max(actors, key=lambda one: -(one.matrix_world.translation.length)))
    scene.unisim.show_timeline = scene.unisim_motion.show_graph = True
    space.shading.type = "SOLID"
    space.shading.background_type, space.shading.background_color = "VIEWPORT", (1.0, 1.0, 1.0)
    yield 1.0
    screenshot("overview_graphs")
    bpy.ops.unisim.shift_ego(left_m=1.0)
    scene.unisim.show_recorded = True
    yield 3.0
    screenshot("overview_notices")
    space.shading.type = "RENDERED"
    yield from wait_for_image()
    options(mode="SPLIT", unsupported=True)
    yield 1.5
    screenshot("overview_split_moved")
    bpy.ops.unisim.shift_ego(left_m=-1.0)
    yield 1.0
    yield from wait_for_image()
    yield 0.5
    screenshot("overview_split")
    options(mode="DIFFERENCE")
    yield 1.5
    screenshot("overview_difference")
    scene.unisim.show_timeline = False
    redraw()
    yield 0.5
    screenshot("overview_difference_graph")
    scene.frame_set(scene.frame_end + 1)
    yield 2.0
    screenshot("overview_outside")
    options(mode="RENDERED", unsupported=False)
    space.shading.type = "SOLID"
    scene.frame_set(0)
    redraw()


def tabs() -> Iterator[float]:
    """Each tab of the sidebar, or earlier versions' one from top to end."""
    manager = bpy.context.window_manager
    kinds = ("VIEW", "EDIT", "SIMULATE", "RENDER") if hasattr(manager, "unisim_panels") else ("",)
    region = region_of(area("VIEW_3D"), "UI")
    for kind in kinds:
        if kind:
            manager.unisim_panels = kind
            redraw()
        yield 0.7
        screenshot(f"overview_tab_{kind.lower()}")
        yield from to(region.x + 0.04 * region.width, region.y + region.height / 2)
        for _ in range(12):
            yield from key("WHEELDOWNMOUSE")
        yield 0.5
        lowest = -round(region.view2d.region_to_view(0, 0)[1])
        results.setdefault("heights_px", {})[kind] = (lowest, region.height)  # type: ignore[index]
        screenshot(f"overview_tab_{kind.lower()}_end")
        yield from key("HOME")
        yield 0.3
    yield from to(*middle(area("VIEW_3D")))


def german() -> Iterator[float]:
    """The sidebar's tasks in German."""
    view_preferences = bpy.context.preferences.view
    view_preferences.language, view_preferences.use_translate_interface = "de_DE", True
    for kind in ("VIEW", "EDIT"):
        bpy.context.window_manager.unisim_panels = kind
        redraw()
        yield 0.7
        screenshot(f"overview_german_{kind.lower()}")
    view_preferences.language = "en_US"


def steps() -> Iterator[float]:
    """The session."""
    yield from imported()
    for name, todo in (
        ("steady_header", steady_header),
        ("sidebar_tabs", tabs),
        ("overlaid_view", overlaid),
        ("german_tabs", german),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "overview")
