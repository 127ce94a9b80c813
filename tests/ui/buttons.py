"""Real buttons, found where a person finds them: by holding the mouse over them and asking Blender what lies there.

Blender's Python does not say where a button is drawn. A button that is under the mouse answers two operators, though: the one
behind Ctrl-C copies the Python command of an operator's button, the one behind Ctrl-Shift-Alt-C the data path of a property's.
`buttons` moves the mouse over a region row by row and notes the answers with their places; `press` clicks on one of them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import bpy
from hands import click, key, mouse, to, write
from session import inside, view

ROW = 8
"""Distance of two looks, in pixels: a row of buttons is 20 pixels high."""
HEADER = tuple(0.7 + 0.0125 * column for column in range(24))
"""Where the right part of a view's header is looked at, as shares of its width."""
HEADER_HIGH = 20
"""Height of a row of buttons, in pixels."""

Place = tuple[int, int]


def region_of(found: bpy.types.Area, kind: str) -> bpy.types.Region:
    """Return the region of an area by its type, "UI" for the sidebar, "HEADER", "HUD"."""
    return next(region for region in found.regions if region.type == kind)


def under_mouse(found: bpy.types.Area, region: bpy.types.Region) -> str:
    """Return the command, "unisim.check()", or the property's path, of the button that the mouse is over; "" where none is."""
    manager = bpy.context.window_manager
    window = next(one for one in manager.windows if found in list(one.screen.areas))
    with bpy.context.temp_override(window=window, area=found, region=region):
        for copy in (bpy.ops.ui.copy_python_command_button, bpy.ops.ui.copy_data_path_button):
            manager.clipboard = ""
            if copy.poll():
                more = {"full_path": True} if copy is bpy.ops.ui.copy_data_path_button else {}
                copy(**more)
                return manager.clipboard.removeprefix("bpy.ops.").removeprefix("bpy.")
    return ""


def buttons(
    found: bpy.types.Area, kind: str, into: dict[str, list[Place]], columns: tuple[float, ...] = (0.5,)
) -> Iterator[float]:
    """Note all buttons of a region in ``into``: by command or path the places of each, from the top, then from the left.
    ``columns``: where rows are looked at, as shares of the region's width."""
    region = region_of(found, kind)
    rows: dict[str, dict[int, list[Place]]] = {}
    one_row = region.height < 2 * HEADER_HIGH
    downs = (region.height // 2,) if one_row else range(ROW // 2, region.height, ROW)
    for share in columns:
        for down in downs:
            yield from to(region.x + share * region.width, region.y + region.height - down)
            yield 0.0  # the button hears of the mouse in the next round
            name = under_mouse(found, region)
            if name:
                rows.setdefault(name, {}).setdefault(mouse[0], []).append((mouse[0], mouse[1]))
    into.clear()
    for name, by_column in rows.items():
        # the middle of a button; at its very edge the mouse may not hold it yet
        into[name] = [places[len(places) // 2] for places in by_column.values() if one_row or len(places) > 1]


def place_of(name: str, kind: str = "UI", columns: tuple[float, ...] = (0.5,), where: str = "VIEW_3D") -> Iterator[float]:
    """Find a button by a part of its command or path, scrolling the sidebar where it is out of sight.

    ``kind``: in which region of the area ``where``. The places go to `found_at`."""
    area = next(a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == where)
    region = region_of(area, kind)
    found: dict[str, list[Place]] = {}
    found_at.clear()
    for scrolled in range(6):
        yield from buttons(area, kind, found, columns)
        found_at.extend(place for known, places in found.items() if name in known for place in places)
        if found_at or kind != "UI":
            break
        yield from to(region.x + region.width / 2, region.y + region.height / 2)
        yield from scroll("HOME" if scrolled == 0 else "")
    assert found_at, f"there is no button {name}; there are {', '.join(found)}"


def scroll(where: str = "") -> Iterator[float]:
    """Scroll the region under the mouse down, or with "HOME" to its top."""
    if where == "HOME":
        yield from key("HOME")
    else:
        for _ in range(10):
            yield from key("WHEELDOWNMOUSE")
    yield 0.3


def press(
    name: str, kind: str = "UI", last: bool = False, columns: tuple[float, ...] = (0.5,), where: str = "VIEW_3D"
) -> Iterator[float]:
    """Click on the button whose command or path has ``name`` in it; ``last``: of several, that on the right."""
    yield from place_of(name, kind, columns, where)
    yield from to(*(max(found_at) if last else found_at[0]))
    yield from click()
    yield 0.2


found_at: list[Place] = []
"""Where `place_of` found a button."""


def redo_panel(value: str, new: str) -> Iterator[float]:
    """Press F9, look in the redo panel that pops up for the field that shows ``value``, and type ``new`` into it.

    Ctrl-C over a field copies its value, which tells the fields from each other.
    """
    manager, (x, y) = bpy.context.window_manager, mouse
    yield from key("F9")
    yield 0.5
    for down in range(30, -200, -6):
        yield from to(x + 222, y + down)
        manager.clipboard = ""
        yield from key("C", ctrl=True)
        if same_number(manager.clipboard, value):
            break
    else:
        raise AssertionError(f"no field of the redo panel shows {value}")
    yield from key("RET")
    yield 0.1
    yield from key("A", ctrl=True)
    yield from write(new)
    yield from key("RET")
    yield 0.3
    yield from to(x - 300, y)  # a popup closes when the mouse leaves it, in 5.2 by Esc
    yield 0.2
    yield from key("ESC")
    yield 0.2


def same_number(text: str, value: str) -> bool:
    """Return whether a text, which may have a unit behind it, is a number to a thousandth."""
    found = re.match(r"-?[0-9.]+", text)
    return found is not None and abs(float(found[0]) - float(value)) < 1e-3


def menu_button(above: str, entry: int) -> Iterator[float]:
    """Click on the button below the one named ``above``, which opens a menu, and choose its entry by number, from 0.

    Buttons that open menus answer neither of the two operators, so they are found by their neighbour.
    """
    yield from place_of(above)
    x, y = found_at[0]
    yield from to(x, y - 20)
    yield from click()
    yield 0.4
    yield from to(x - 40, y - 20 - 24 - 23 * entry)
    yield 0.1
    yield from click()
    yield 0.3


def reports() -> list[str]:
    """Return what operators have told the person so far, one line each, the newest last, as an Info editor shows it."""
    found = next(a for a in bpy.context.window_manager.windows[0].screen.areas if a.type in ("DOPESHEET_EDITOR", "INFO"))
    kind, manager = found.ui_type, bpy.context.window_manager
    found.ui_type = "INFO"
    try:
        with inside(found):
            bpy.ops.info.select_all(action="SELECT")
            manager.clipboard = ""
            bpy.ops.info.report_copy()
            return manager.clipboard.splitlines()
    finally:
        found.ui_type = kind


def open_panel(below: str, down: int, holds: str) -> Iterator[float]:
    """Open a closed panel by a click on its header, ``down`` pixels below the button ``below``, unless ``holds`` is in sight."""
    area, _, _ = view()
    found: dict[str, list[Place]] = {}
    yield from buttons(area, "UI", found)
    if any(holds in name for name in found):
        return
    yield from place_of(below)
    x, y = found_at[0]
    yield from to(x, y - down)
    yield from click()
    yield 0.5
