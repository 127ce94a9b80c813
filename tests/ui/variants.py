"""Variants with mouse and keys. Run by `run.py`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import hands
from browser import choose_path
from buttons import found_at, held, open_panel, place_of, region_of
from edit_panel import apart, listed, module, moved_along, opened, picked, press, rendered, shown_pixels
from hands import click, key, middle, object_named, to
from session import OUT, area, screenshot, start, until, view, wait_for_image
from tasks import bare_view, begin, seen, task, told

ARROWS = 0.75
"""Where in its row the button that compares a variant is, as a share of the sidebar's width."""
CLOSE = 0.825
"""Where beside a comparison's head the X is that ends it."""
names: dict[str, str] = {}
"""Names of the variants, and of the car that is moved."""


def first_edit() -> Iterator[float]:
    """A car that drives is moved in the first variant."""
    names["moved"] = seen(driving=True)
    yield from picked(names["moved"])
    yield from moved_along(("G",), ("Y",), ("THREE", "3"), ("RET",))
    yield from listed(("Moved 3.0 m", False))


def made_variant() -> Iterator[float]:
    """New, a name, Enter; the new variant is shown, and one of its cars is moved."""
    space = view()[1]
    space.shading.type, space.show_object_viewport_mesh = "SOLID", True
    first = bpy.context.scene.name
    yield from press("unisim.new_variant", across=0.2)
    yield 0.5
    screenshot("variants_name")
    yield from key("RET")
    yield from until(lambda: bpy.context.scene.name == "Variant 2", "there is no new variant")
    yield from listed(("Moved 3.0 m", False))
    yield 0.5
    screenshot("variants_variant")
    names["first"], names["second"] = first, "Variant 2"
    yield from to(*middle(area("VIEW_3D")))
    car = next(one for one in bpy.context.scene.objects if one.unisim.called == names["moved"]).name
    yield from picked(car)
    yield from moved_along(("G",), ("Y",), ("TWO", "2"), ("RET",))
    yield from listed(("Moved 5.0 m", False))


def switched_variant() -> Iterator[float]:
    """A click on the other variant's name shows it: its car stands where it was."""
    yield from press("unisim.show_variant", across=0.2, name=names["first"])
    yield from until(lambda: bpy.context.scene.name == names["first"], "the variant is not shown")
    yield from listed(("Moved 3.0 m", False))
    assert abs(object_named(names["moved"]).location.length - 3.0) < 1e-3


def flipped_variants() -> Iterator[float]:
    """In Rendered shading, a click on the other variant shows its image, and a click on the first one
    that one's again."""
    space = view()[1]
    bare_view(space)
    yield from to(*middle(area("VIEW_3D")))
    yield from rendered()
    first = shown_pixels("variants_image_first")
    yield from press("unisim.show_variant", across=0.2, name=names["second"])
    yield from wait_for_image()
    yield 1.0
    second = shown_pixels("variants_image_second")
    assert apart(first, second) > 0.003, "the other variant's image is the same"
    yield from press("unisim.show_variant", across=0.2, name=names["first"])
    yield from wait_for_image()
    yield 1.0
    assert apart(first, shown_pixels("variants_image_again")) < 0.002, "the first variant's image is another one now"
    space.shading.type = "SOLID"


def compared_variants() -> Iterator[float]:
    """A click on the arrows beside the other one lists what differs; a click on that selects the car, and the X above it
    ends the comparison."""
    drawn: list[tuple[str, str, str]] = []
    panel = module("features.variants.panel")
    draw = panel.draw_difference

    def noted(layout: Any, found: Any, here: str, there: str) -> None:
        drawn.append((here, there, found.here.key[1]))
        draw(layout, found, here, there)

    panel.draw_difference = noted
    try:
        yield from press("unisim.compare_variant", across=ARROWS, name=names["second"])
        yield from until(lambda: drawn, "the panel shows no difference", 10)
    finally:
        panel.draw_difference = draw
    car, uid = names["moved"], object_named(names["moved"]).unisim.uid
    assert set(drawn) == {(names["first"], names["second"], uid)}, drawn
    yield 1.0
    reading = module("bridge.sampling.edit_list").reading_of
    both = [reading(bpy.data.scenes[names[name]]).lines for name in ("first", "second")]
    (one,) = module("editing.edits.variants").differences(*both)
    assert one.here.what.startswith("Moved 3.0 m") and one.there.what.startswith("Moved 5.0 m")
    head = (f'unisim.compare_variant(name="{names["second"]}")',)
    yield from place_of(head, columns=(CLOSE,))  # the X beside the comparison's head
    x, y = found_at[0]
    for other in bpy.context.selected_objects:
        other.select_set(False)
    here = [""]
    for down in range(10, 80, 6):
        yield from held(view()[0], region_of(view()[0], "UI"), x - 150, y - down, here)
        if "unisim.go_to_edit(" in here[0] and f'name="{uid}"' in here[0]:
            break
    else:
        raise AssertionError("below the comparison's head is no line of the car's difference")
    yield from click()
    yield from until(lambda: object_named(car).select_get(), "a click on the difference does not select the car", 5)
    screenshot("variants_difference_chosen")
    for wheel, name in (("WHEELDOWNMOUSE", "variants_comparison"), ("WHEELUPMOUSE", "variants_scrolled_back")):
        for _ in range(12):
            hands.event(wheel, "PRESS")
            yield 0.05
        yield 0.5
        screenshot(name)
    yield from place_of(head, columns=(CLOSE,))
    yield from to(*found_at[0])
    yield from click()
    yield from until(lambda: not bpy.context.window_manager.unisim_compared, "the X does not end the comparison", 5)


def deleted_variant() -> Iterator[float]:
    """The bin, confirmed, deletes the variant that is shown; Ctrl-Z brings it back."""
    yield from press("unisim.show_variant", across=0.2, name=names["second"])
    yield from until(lambda: bpy.context.scene.name == names["second"], "the variant is not shown")
    yield 0.5
    yield from press("unisim.delete_variant", across=0.825)
    yield 0.5
    screenshot("variants_confirm")
    yield from key("RET")
    yield from until(lambda: len(bpy.data.scenes) == 1, "the variant is not deleted")
    yield from listed(("Moved 3.0 m", False))
    yield from to(*middle(area("VIEW_3D")))
    yield from key("Z", ctrl=True)
    yield from until(lambda: names["second"] in bpy.data.scenes, "the variant does not come back")
    reading = module("bridge.sampling.edit_list").reading_of
    yield from until(lambda: reading(bpy.data.scenes[names["second"]]).fresh, "it is not read")
    assert [line.what for line in reading(bpy.data.scenes[names["second"]]).lines] == ["Moved 5.0 m left"]


def exported_variants() -> Iterator[float]:
    """Export Variants, a folder chosen in the file browser: a scenario of each, with its own edits."""
    folder = OUT.parent / "exported"
    folder.mkdir(exist_ok=True)
    yield from press("unisim.export_variants")
    yield from until(lambda: len(bpy.context.window_manager.windows) > 1, "no file browser opens", 10)
    yield 0.5
    yield from choose_path(folder, folder=True)
    yield from until(lambda: len(list(folder.glob("*.json"))) == 2, "the scenarios are not written", 60)
    yield 0.5
    moves = {}
    for path in folder.glob("*.json"):
        (edit,) = json.loads(path.read_text())["edits"]
        assert edit["type"] == "move"
        moves[path.stem] = edit
    assert set(moves) == {names["first"], names["second"]}, moves.keys()
    assert moves[names["first"]] != moves[names["second"]], "both have the same edit"
    metres = {name: float(np.linalg.norm(moved_by(edit))) for name, edit in moves.items()}
    assert abs(metres[names["first"]] - 3.0) < 0.02 and abs(metres[names["second"]] - 5.0) < 0.02, metres


def moved_by(edit: Any) -> Any:
    """By how many metres an exported move is away from the recorded trajectory, at its first key, (3,)."""
    if "offset_m" in edit:
        return np.array(edit["offset_m"])
    drive = module("bridge.objects.imported").source_of(bpy.context.scene).drive
    recorded = drive.actors[edit["actor"]].world_from_actor
    first = edit["trajectory"][0]
    time_s = first["time_s"] if "time_s" in first else recorded.times_s[0]
    return np.array(first["position"]) - recorded.at(time_s)[:3, 3]


def rendered_variants() -> Iterator[float]:
    """Render Variants, by a click: both are rendered, with progress."""
    root = OUT.parent / "variants"
    for scene in bpy.data.scenes:
        scene.unisim.out, scene.frame_start, scene.frame_end = str(root), 4, 5
    yield from press("unisim.render_variants")
    yield from until(lambda: "of 4 frames in all" in told(), f"no progress is shown: {told()}", 60)
    yield 1.0
    for _ in range(12):
        hands.event("WHEELDOWNMOUSE", "PRESS")
        yield 0.05
    yield 0.5
    screenshot("variants_rendering")
    yield from until(lambda: told().startswith("Done"), "the variants are not rendered", 300)
    images = {name: sorted((root / names[name]).glob("camera/*/*.png")) for name in ("first", "second")}
    assert [len(found) for found in images.values()] == [2, 2], told()
    assert images["first"][0].read_bytes() != images["second"][0].read_bytes()


def steps() -> Iterator[float]:
    """The session."""
    yield from opened()
    yield from open_panel("Variants", "unisim.new_variant", 0.2)
    begin()
    for name, todo in (
        ("variants_first_edit", first_edit),
        ("variants_new", made_variant),
        ("variants_switched", switched_variant),
        ("variants_flipped", flipped_variants),
        ("variants_compared", compared_variants),
        ("variants_deleted", deleted_variant),
        ("variants_exported", exported_variants),
        ("variants_rendered", rendered_variants),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "variants")
