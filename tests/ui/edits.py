"""The edits list and variants with mouse and keys, judged by what the screen shows. Run by `run.py`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
import hands
from hands import click, drop, key, middle, place, sidebar, thing, to, write
from session import ARCHIVE, MODULE, OUT, SCENE, area, inside, results, screenshot, start, until, view, wait_for_picture
from tasks import bare_view, begin, seen, task

STEP = 8
"""Pixels between two looks for a button."""
BACK = 0.01
"""Share of the view's pixels that may differ where an image is to be the same again."""
found: list[Any] = []
"""The operator of the button under the mouse, as its context menu was told of it."""
images: dict[str, NDArray[np.float32]] = {}
names: dict[str, str] = {}
"""Names of the objects that are edited."""


def module(name: str) -> Any:
    """A module of the extension."""
    return sys.modules[f"{MODULE}.{name}"]


def lines() -> list[Any]:
    """The list that the panel shows; none while it is being read."""
    reading = module("bridge.edit_reading").reading_of(bpy.context.scene)
    return list(reading.lines) if reading.fresh else []


def listed(*wanted: tuple[str, bool]) -> Iterator[float]:
    """Wait until the panel shows these edits: how each begins, and whether it is muted."""

    def told() -> bool:
        now = sorted((line.what, line.muted >= 0) for line in lines())
        return len(now) == len(wanted) and all(
            a.startswith(b) and muted == is_muted for (a, muted), (b, is_muted) in zip(now, sorted(wanted), strict=True)
        )

    yield from until(told, f"the list does not show {wanted}, but {[(line.what, line.muted) for line in lines()]}", 10)
    yield 0.3


def note_button(self: Any, context: Any) -> None:
    """Part of a button's context menu: note whose it is."""
    found[:] = [getattr(context, "button_operator", None)]


def button(name: str, across: float = 0.3, **values: object) -> Iterator[float]:
    """Put the mouse on a button of the sidebar: that of an operator, with some of its properties. ``across``: where in the row."""
    tabs = next(r for r in area("VIEW_3D").regions if r.type == "UI")
    category, group = f"{name.split('.')[0].upper()}_OT_{name.split('.')[1]}", []
    for down in range(40, tabs.height - 4, STEP):
        for x in (across, across + 0.06, across - 0.06) if across < 0.5 else (across,):
            yield from to(tabs.x + tabs.width * x, tabs.y + tabs.height - down)
            yield 0.02
            found.clear()
            yield from key("RIGHTMOUSE")
            yield 0.06
            here = found[0] if found else None
            if found:
                yield from key("ESC")
                yield 0.04
            if here is None:
                continue
            group.append(here.bl_rna.identifier)
            if here.bl_rna.identifier == category and all(getattr(here, k) == v for k, v in values.items()):
                yield from to(tabs.x + tabs.width * x, tabs.y + tabs.height - down - 2)
                yield 0.1
                return
            break
    raise AssertionError(f"{name} {values} is not in the sidebar, only {sorted(set(group))}")


def press(name: str, across: float = 0.3, **values: object) -> Iterator[float]:
    """Find a button and click it."""
    yield from button(name, across, **values)
    yield from click()
    yield 0.3


def line_of(begins: str) -> dict[str, object]:
    """The properties of the buttons of the line that begins so."""
    line = next(line for line in lines() if line.what.startswith(begins))
    kind, name, part = line.key
    return {"kind": kind, "name": name, "part": part, "muted": line.muted}


def shown_pixels(name: str) -> NDArray[np.float32]:
    """What the screen shows in the 3D view left of the sidebar, (H, W, 3) in steps of eight bits."""
    screenshot(name)
    image = bpy.data.images.load(str(OUT / f"{name}.png"), check_existing=False)
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    screen = np.array(image.pixels[:], np.float32).reshape(height, width, -1)[..., :3] * 255
    bpy.data.images.remove(image)
    regions = {region.type: region for region in area("VIEW_3D").regions}
    region, tabs = regions["WINDOW"], regions["UI"]
    return screen[region.y + 40 : region.y + region.height - 60, region.x + 80 : tabs.x - 10]


def apart(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """The share of pixels in which two pictures differ."""
    return float((np.abs(a - b).max(-1) > 6).mean())


def rendered() -> Iterator[float]:
    """Rendered shading, until the picture is finished."""
    view()[1].shading.type = "RENDERED"
    yield from wait_for_picture()
    yield 0.5


def picked(name: str) -> Iterator[float]:
    """Click an object in the view."""
    yield from to(*place(thing(name).matrix_world.translation))
    yield from click()
    yield from until(lambda: bpy.context.view_layer.objects.active == thing(name), f"{name} is not selected")


def recorded_image() -> Iterator[float]:
    """The unedited drive: the list is empty, and the image is kept to compare with."""
    yield from sidebar()
    space = view()[1]
    panels = area("VIEW_3D")
    with inside(panels):
        bpy.ops.screen.screen_full_area()
    yield 1.0
    yield from until(lambda: module("bridge.edit_reading").reading_of(bpy.context.scene).fresh, "the list is not read")
    assert not lines()
    screenshot("edits_none")
    space = view()[1]
    bare_view(space)
    yield from to(*middle(area("VIEW_3D")))
    yield from rendered()
    images["recorded"] = shown_pixels("edits_recorded")
    space.shading.type, space.show_object_viewport_mesh = "SOLID", True
    yield 0.5


def three_edits() -> Iterator[float]:
    """One car moved, one deleted, one copied, with mouse and keys; the list has a line for each."""
    names["moved"] = seen(driving=True)
    yield from picked(names["moved"])
    for press_ in (("G",), ("Y",), ("THREE", "3"), ("RET",)):
        yield from key(*press_)
    yield from listed(("Moved 3.0 m", False))
    names["removed"] = seen(driving=False)
    yield from picked(names["removed"])
    yield from key("X")
    yield 0.2
    yield from key("RET")
    yield from listed(("Moved 3.0 m", False), ("Removed", False))
    names["copied"] = seen(driving=False)
    yield from picked(names["copied"])
    yield from key("D", shift=True)
    for press_ in (("X",), ("THREE", "3"), ("RET",)):
        yield from key(*press_)
    yield from listed(("Moved 3.0 m", False), ("Removed", False), ("Copied", False))


def clicked_line() -> Iterator[float]:
    """A click on a line selects its object."""
    yield from press("unisim.go_to_edit", **line_of("Moved"))
    yield from until(
        lambda: bpy.context.selected_objects == [thing(names["moved"])], "a click on a line does not select the object"
    )


def muted_edits() -> Iterator[float]:
    """With the picture rendered, a click on each eye brings back what was recorded; further clicks bring the edits back."""
    space = view()[1]
    space.show_object_viewport_mesh = False
    yield from to(*middle(area("VIEW_3D")))
    yield from rendered()
    images["edited"] = shown_pixels("edits_edited")
    results["edited_differs"] = apart(images["edited"], images["recorded"])
    assert apart(images["edited"], images["recorded"]) > BACK, "the edits do not show"
    yield from press("unisim.mute_edit", across=0.78, **line_of("Moved"))
    yield from listed(("Moved 3.0 m", True), ("Removed", False), ("Copied", False))
    assert thing(names["moved"]).location.length < 1e-4
    yield from wait_for_picture()
    yield 0.5
    one = shown_pixels("edits_one_muted")
    assert apart(one, images["edited"]) > 0.001, "muting a move does not show"
    for begins in ("Removed", "Copied"):
        yield from press("unisim.mute_edit", across=0.78, **line_of(begins))
        yield 0.5
    yield from listed(("Moved 3.0 m", True), ("Removed", True), ("Copied", True))
    assert not hands.edits()
    yield from wait_for_picture()
    yield 0.5
    images["muted"] = shown_pixels("edits_muted")
    results["muted_differs"] = apart(images["muted"], images["recorded"])
    assert apart(images["muted"], images["recorded"]) < BACK, "muted edits show"
    for begins in ("Moved", "Removed", "Copied"):
        yield from press("unisim.mute_edit", across=0.78, **line_of(begins))
        yield 0.5
    yield from listed(("Moved 3.0 m", False), ("Removed", False), ("Copied", False))
    yield from wait_for_picture()
    yield 0.5
    results["unmuted_differs"] = apart(shown_pixels("edits_unmuted"), images["edited"])
    assert results["unmuted_differs"] < BACK, "unmuted edits do not show as before"  # type: ignore[operator]


def undone_mute() -> Iterator[float]:
    """A mute is one undo step."""
    yield from press("unisim.mute_edit", across=0.78, **line_of("Moved"))
    yield from listed(("Moved 3.0 m", True), ("Removed", False), ("Copied", False))
    yield from to(*middle(area("VIEW_3D")))
    yield from key("Z", ctrl=True)
    yield from listed(("Moved 3.0 m", False), ("Removed", False), ("Copied", False))


def reverted_edit() -> Iterator[float]:
    """A click on the arrow of the removed car brings it back; Ctrl-Z removes it again."""
    yield from press("unisim.revert_edit", across=0.86, **line_of("Removed"))
    yield from listed(("Moved 3.0 m", False), ("Copied", False))
    assert any(one.unisim.uid and one.name == names["removed"] for one in bpy.context.scene.objects)
    yield from to(*middle(area("VIEW_3D")))
    yield from key("Z", ctrl=True)
    yield from listed(("Moved 3.0 m", False), ("Removed", False), ("Copied", False))
    yield from key("Z", ctrl=True, shift=True)
    yield from listed(("Moved 3.0 m", False), ("Copied", False))


def made_variant() -> Iterator[float]:
    """New, a name, Enter; the new variant is shown, and one of its cars is moved."""
    space = view()[1]
    space.shading.type, space.show_object_viewport_mesh = "SOLID", True
    first = bpy.context.scene.name
    yield from press("unisim.new_variant", across=0.2)
    yield 0.5
    screenshot("edits_name")
    yield from key("RET")
    yield from until(lambda: bpy.context.scene.name == "Variant 2", "there is no new variant")
    yield from listed(("Moved 3.0 m", False), ("Copied", False))
    yield 0.5
    screenshot("edits_variant")
    names["first"], names["second"] = first, "Variant 2"
    yield from to(*middle(area("VIEW_3D")))
    car = next(one for one in bpy.context.scene.objects if one.unisim.called == names["moved"]).name
    yield from picked(car)
    for press_ in (("G",), ("Y",), ("TWO", "2"), ("RET",)):
        yield from key(*press_)
    yield from listed(("Moved 5.0 m", False), ("Copied", False))


def switched_variant() -> Iterator[float]:
    """A click on the other variant's name shows it: its car stands where it was."""
    yield from press("unisim.show_variant", across=0.2, name=names["first"])
    yield from until(lambda: bpy.context.scene.name == names["first"], "the variant is not shown")
    yield from listed(("Moved 3.0 m", False), ("Copied", False))
    assert abs(thing(names["moved"]).location.length - 3.0) < 1e-3


def compared_variants() -> Iterator[float]:
    """A click on the arrows beside the other one lists what differs."""
    yield from press("unisim.compare_variant", across=0.78, name=names["second"])
    yield 1.0
    reading = module("bridge.edit_reading").reading_of
    both = [reading(bpy.data.scenes[names[name]]).lines for name in ("first", "second")]
    (one,) = module("bridge.compare_edits").differences(*both)
    assert one.here.what.startswith("Moved 3.0 m") and one.there.what.startswith("Moved 5.0 m")


def rendered_variants() -> Iterator[float]:
    """Render Variants, by a click: both are rendered, with progress."""
    root = OUT.parent / "variants"
    for scene in bpy.data.scenes:
        scene.unisim.out, scene.frame_start, scene.frame_end = str(root), 4, 5
    manager = bpy.context.window_manager
    yield from press("unisim.render_variants")
    yield from until(lambda: "of 4 frames in all" in manager.unisim_task, f"no progress is shown: {manager.unisim_task}", 60)
    yield 1.0
    screenshot("edits_rendering")
    yield from until(lambda: manager.unisim_task.startswith("Done"), "the variants are not rendered", 300)
    pictures = {name: sorted((root / names[name]).glob("camera/*/*.png")) for name in ("first", "second")}
    assert [len(found) for found in pictures.values()] == [2, 2], manager.unisim_task
    assert pictures["first"][0].read_bytes() != pictures["second"][0].read_bytes()


def steps() -> Iterator[float]:
    """The session."""
    bpy.ops.extensions.package_install_files(filepath=str(ARCHIVE), repo="user_default", enable_on_install=True, overwrite=True)
    yield 1.0
    bpy.types.UI_MT_button_context_menu.append(note_button)
    yield from to(*middle(area("VIEW_3D")))
    drop(SCENE)
    scene = bpy.context.scene
    yield from until(lambda: scene.render.engine == "UNISIM" and scene.camera.unisim.kind == "CAMERA", "the import does not end")
    yield 0.5
    begin()
    for name, todo in (
        ("edits_recorded_image", recorded_image),
        ("edits_three", three_edits),
        ("edits_clicked_line", clicked_line),
        ("edits_mute", muted_edits),
        ("edits_undone_mute", undone_mute),
        ("edits_reverted", reverted_edit),
        ("edits_made_variant", made_variant),
        ("edits_switched", switched_variant),
        ("edits_compared", compared_variants),
        ("edits_render_both", rendered_variants),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    assert write is not None
    start(steps(), "edits")
