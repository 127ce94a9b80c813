"""The edits list with mouse and keys, judged by what the screen shows. Run by `run.py`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
import hands
from buttons import found_at, place_of, region_of
from edit_panel import apart, line_of, listed, moved_along, opened, picked, press, rendered, shown_pixels, toggled
from hands import key, middle, object_named, to
from session import area, results, screenshot, start, until, view, wait_for_image
from tasks import bare_view, begin, seen, task

BACK = 0.01
"""Share of the view's pixels that may differ where an image is to be the same again."""
COUNTS = 0.74
"""Where in its row the check mark of an edit is, as a share of the sidebar's width."""
ARROW = 0.81
ROW_PX = 20
"""How high a row of the sidebar is, in pixels."""
images: dict[str, NDArray[np.float32]] = {}
names: dict[str, str] = {}
"""Names of the objects that are edited."""


def recorded_image() -> Iterator[float]:
    """The unedited drive: the list is empty, and the image is kept to compare with."""
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
    yield from moved_along(("G",), ("Y",), ("THREE", "3"), ("RET",))
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
    yield from moved_along(("X",), ("THREE", "3"), ("RET",))
    yield from listed(("Moved 3.0 m", False), ("Removed", False), ("Copied", False))


def clicked_line() -> Iterator[float]:
    """A click on a line selects its object."""
    yield from press("unisim.go_to_edit", **line_of("Moved"))
    yield from until(
        lambda: bpy.context.selected_objects == [object_named(names["moved"])],
        "a click on a line does not select the object",
    )


def muted_edits() -> Iterator[float]:
    """With the image rendered, a click on each eye brings back what was recorded; further clicks bring the edits
    back."""
    space = view()[1]
    space.show_object_viewport_mesh = False
    yield from to(*middle(area("VIEW_3D")))
    yield from rendered()
    images["edited"] = shown_pixels("edits_edited")
    results["edited_differs"] = apart(images["edited"], images["recorded"])
    assert apart(images["edited"], images["recorded"]) > BACK, "the edits do not show"
    yield from toggled("Moved", COUNTS, ("Moved 3.0 m", True), ("Removed", False), ("Copied", False))
    assert object_named(names["moved"]).location.length < 1e-4
    yield from wait_for_image()
    yield 0.5
    one = shown_pixels("edits_one_muted")
    assert apart(one, images["edited"]) > 0.001, "muting a move does not show"
    yield from toggled("Removed", COUNTS, ("Moved 3.0 m", True), ("Removed", True), ("Copied", False))
    yield from toggled("Copied", COUNTS, ("Moved 3.0 m", True), ("Removed", True), ("Copied", True))
    assert not hands.edits()
    yield from wait_for_image()
    yield 0.5
    images["muted"] = shown_pixels("edits_muted")
    results["muted_differs"] = apart(images["muted"], images["recorded"])
    assert apart(images["muted"], images["recorded"]) < BACK, "muted edits show"
    yield from toggled("Moved", COUNTS, ("Moved 3.0 m", False), ("Removed", True), ("Copied", True))
    yield from toggled("Removed", COUNTS, ("Moved 3.0 m", False), ("Removed", False), ("Copied", True))
    yield from toggled("Copied", COUNTS, ("Moved 3.0 m", False), ("Removed", False), ("Copied", False))
    yield from wait_for_image()
    yield 0.5
    results["unmuted_differs"] = apart(shown_pixels("edits_unmuted"), images["edited"])
    assert results["unmuted_differs"] < BACK, "unmuted edits do not show as before"  # type: ignore[operator]


def undone_mute() -> Iterator[float]:
    """A mute is one undo step."""
    yield from toggled("Moved", COUNTS, ("Moved 3.0 m", True), ("Removed", False), ("Copied", False))
    yield from to(*middle(area("VIEW_3D")))
    yield from key("Z", ctrl=True)
    yield from listed(("Moved 3.0 m", False), ("Removed", False), ("Copied", False))


def reverted_edit() -> Iterator[float]:
    """A click on the arrow of the removed car brings it back; Ctrl-Z removes it again."""
    yield from press("unisim.revert_edit", across=ARROW, **line_of("Removed"))
    yield from listed(("Moved 3.0 m", False), ("Copied", False))
    assert any(one.unisim.uid and one.name == names["removed"] for one in bpy.context.scene.objects)
    yield from to(*middle(area("VIEW_3D")))
    yield from key("Z", ctrl=True)
    yield from listed(("Moved 3.0 m", False), ("Removed", False), ("Copied", False))
    yield from key("Z", ctrl=True, shift=True)
    yield from listed(("Moved 3.0 m", False), ("Copied", False))


def long_lines() -> Iterator[float]:
    """A camera with a long name and a car that is retimed and moved: their lines go on in further rows."""
    one, space = view()[:2]
    space.shading.type, space.show_object_viewport_mesh = "SOLID", True
    bpy.context.scene.camera.name = "front_left_camera_of_the_second_vehicle_in_the_garage"
    yield 0.5
    yield from picked(names["moved"])
    yield from key("T", ctrl=True, alt=True)
    yield from listed(("Retimed", False), ("Copied", False), ("Camera copied", False), ("Camera removed", False))
    heights = []
    for begins in ("Camera copied", "Camera removed", "Copied", "Retimed"):  # from below: the last one is scrolled to
        line = line_of(begins)
        button = ("unisim.mute_edit(", f'kind="{line["kind"]}"', f'name="{line["name"]}"', f'part="{line["part"]}"')
        yield from place_of(button, columns=(COUNTS,))
        heights.append((found_at[0][1], round(region_of(one, "UI").view2d.region_to_view(0, 0)[1])))
    screenshot("edits_long_lines")
    assert len({scrolled for _, scrolled in heights}) == 1, "the sidebar was scrolled between two lines"
    _, removed, copied, retimed = (y for y, _ in heights)
    rows = (retimed - copied) - (copied - removed)
    assert abs(rows - ROW_PX) < 6, (
        f"the line Retimed is {rows} pixels higher than the line Copied, and not a row of {ROW_PX}"
    )


def steps() -> Iterator[float]:
    """The session."""
    yield from opened()
    begin()
    for name, todo in (
        ("edits_recorded_image", recorded_image),
        ("edits_three", three_edits),
        ("edits_clicked_line", clicked_line),
        ("edits_mute", muted_edits),
        ("edits_undone_mute", undone_mute),
        ("edits_reverted", reverted_edit),
        ("edits_long", long_lines),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "edits")
