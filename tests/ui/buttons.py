"""Real buttons, found where a person finds them: by holding the mouse over them and asking Blender what lies there.

Blender's Python does not say where a button is drawn. A button that is under the mouse answers two operators, though:
the one behind Ctrl-C copies the Python command of an operator's button, the one behind Ctrl-Shift-Alt-C the data path
of a property's. `buttons` moves the mouse over a region row by row and notes the answers with their places; `press`
clicks on one of them.
"""

from __future__ import annotations

import re
import time
from collections.abc import Generator, Iterator

import bpy
from hands import click, key, mouse, to, write
from session import inside, is_searching, view, waited_s

ROW = 8
"""Distance of two looks, in pixels: a row of buttons is 20 pixels high."""
HEADER = tuple(0.7 + 0.0125 * column for column in range(24))
"""Where the right part of a view's header is looked at, as shares of its width."""
CROSS = 0.84
"""Where the cross beside a progress bar is, as a share of the sidebar's width."""
HEADER_HIGH = 20
"""Height of a row of buttons, in pixels."""

Place = tuple[int, int]


def region_of(found: bpy.types.Area, kind: str) -> bpy.types.Region:
    """Return the region of an area by its type, "UI" for the sidebar, "HEADER", "HUD"."""
    return next(region for region in found.regions if region.type == kind)


def under_mouse(found: bpy.types.Area, region: bpy.types.Region) -> str:
    """Return the command, "unisim.check()", or the property's path, of the button that the mouse is over;
    "" where none is."""
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
    """Note all buttons of a region in ``into``: by command or path the places of each, from the top, then from the
    left. ``columns``: where rows are looked at, as shares of the region's width."""
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


def place_of(
    name: str | tuple[str, ...],
    kind: str = "UI",
    columns: tuple[float, ...] = (0.5,),
    where: str = "VIEW_3D",
    every: bool = False,
) -> Iterator[float]:
    """Find the first button with ``name``, or all of several texts, in its command or path, scrolling the sidebar where
    it is out of sight.

    ``kind``: in which region of the area ``where``; ``every``: find all such buttons. The places go to `found_at`."""
    area = next(a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == where)
    region = region_of(area, kind)
    name = (name,) if isinstance(name, str) else name
    if kind == "UI":
        yield from choose_task(next((tasks for parts, tasks in TASK_OF if re.search(parts, " ".join(name))), ("EDIT",)))
    met: dict[str, list[Place]] = {}
    found_at.clear()
    if not every:
        yield from where_it_was(area, kind, (name, kind, where))
    for scrolled in range(8):
        if found_at:
            break
        if every:
            yield from buttons(area, kind, met, columns)
            found_at.extend(place for known, places in met.items() if is_named(known, name) for place in places)
        else:
            yield from first_of(area, kind, name, columns, met)
        if found_at or kind != "UI":
            break
        yield from to(
            region.x + 0.04 * region.width, region.y + region.height / 2
        )  # beside lists, which would scroll themselves
        yield from scroll("HOME" if scrolled == 0 and not at_top(region) else "")
    assert found_at, f"there is no button {' '.join(name)}; there are {', '.join(met)}"
    if not every:
        KNOWN[name, kind, where] = found_at[0]


def is_named(known: str, name: tuple[str, ...]) -> bool:
    """Return whether a button's command or path has all of some texts in it."""
    return all(text in known for text in name)


Wanted = tuple[tuple[str, ...], str, str]
KNOWN: dict[Wanted, Place] = {}
"""Where buttons were found the last time, by name, region and area."""
COARSE = 12
"""Distance of two looks for one button, in pixels: less than a button is high."""
INNER = 4
"""How far from its place a button has to be under the mouse, too, for the place to be well inside it, in pixels."""


def held(found: bpy.types.Area, region: bpy.types.Region, x: float, y: float, into: list[str]) -> Iterator[float]:
    """Move the mouse to a place; the name of the button that it is over then is ``into[0]``."""
    begun = time.monotonic()
    yield from to(x, y)
    yield 0.0  # the button hears of the mouse in the next round
    into[:] = [under_mouse(found, region)]
    waited_s["search"] += time.monotonic() - begun


def where_it_was(found: bpy.types.Area, kind: str, wanted: Wanted) -> Iterator[float]:
    """Look for a button where it was the last time; where it still is, `found_at` is that place."""
    if wanted not in KNOWN:
        return
    (x, y), region, here = KNOWN[wanted], region_of(found, kind), [""]
    names = set()
    for aside in (0,) if region.height < 2 * HEADER_HIGH else (-INNER, INNER, 0):
        yield from held(found, region, x, y + aside, here)
        names |= set(here)
    if len(names) == 1 and is_named(here[0], wanted[0]):
        found_at[:] = [(x, y)]


def first_of(
    found: bpy.types.Area, kind: str, name: tuple[str, ...], columns: tuple[float, ...], met: dict[str, list[Place]]
) -> Iterator[float]:
    """Look for the first button with all of ``name`` in its command or path, column by column from the top; `found_at`
    is its middle then, else it stays empty. All buttons that were met go to ``met``."""
    region, here = region_of(found, kind), [""]
    one_row = region.height < 2 * HEADER_HIGH
    top = region.y + region.height
    downs = (region.height // 2,) if one_row else range(COARSE // 2, region.height, COARSE)
    for share in columns:
        x = round(region.x + share * region.width)
        for down in downs:
            yield from held(found, region, x, top - down, here)
            if here[0]:
                met.setdefault(here[0], []).append((x, top - down))
            if not here[0] or not is_named(here[0], name):
                continue
            ends, full = [top - down, top - down], here[0]
            for end, step in ((0, -INNER), (1, INNER)):
                while not one_row and region.y < ends[end] + step < top:
                    yield from held(found, region, x, ends[end] + step, here)
                    if here[0] != full:
                        break
                    ends[end] += step
            if one_row or ends[1] - ends[0] >= 2 * INNER:  # what is cut off by the region's edge is scrolled to
                found_at[:] = [(x, (ends[0] + ends[1]) // 2)]
                return


def at_top(region: bpy.types.Region) -> bool:
    """Return whether a region is scrolled to its top."""
    return abs(region.view2d.region_to_view(0, region.height)[1]) < 2


def scroll(where: str = "") -> Iterator[float]:
    """Scroll the region under the mouse down, or with "HOME" to its top."""
    if where == "HOME":
        yield from key("HOME")
    else:
        for _ in range(10):
            yield from key("WHEELDOWNMOUSE")
    yield 0.3


def press(
    name: str | tuple[str, ...],
    kind: str = "UI",
    last: bool = False,
    columns: tuple[float, ...] = (0.5,),
    where: str = "VIEW_3D",
) -> Iterator[float]:
    """Click on the button that `place_of` finds; ``last``: of several, that on the right."""
    yield from place_of(name, kind, columns, where, every=last)
    yield from to(*(max(found_at) if last else found_at[0]))
    yield from click()
    yield 0.2


def typed(member: str, value: str) -> Iterator[float]:
    """Type a value into a number's field of the sidebar."""
    yield from place_of(member, columns=(0.75,))
    yield from to(*found_at[0])
    yield from overwritten(value)


def overwritten(value: str) -> Iterator[float]:
    """Type a value into the field under the mouse, in place of what stands there."""
    yield from key("RET")
    yield 0.1
    yield from key("A", ctrl=True)
    yield from write(value)
    yield from key("RET")
    yield 0.3


found_at: list[Place] = []
"""Where `place_of` found a button."""


def redo_panel(value: str, new: str) -> Iterator[float]:
    """Press F9, look in the redo panel that pops up for the field that shows ``value``, and type ``new`` into it.

    Ctrl-C over a field copies its value, which tells the fields from each other.
    """
    manager, (x, y) = bpy.context.window_manager, mouse
    yield from key("F9")
    yield 0.5
    begun, is_searching[0] = time.monotonic(), True
    for down in range(30, -200, -6):
        yield from to(x + 222, y + down)
        manager.clipboard = ""
        yield from key("C", ctrl=True)
        if same_number(manager.clipboard, value):
            break
    is_searching[0] = False
    assert same_number(manager.clipboard, value), f"no field of the redo panel shows {value}"
    waited_s["search"] += time.monotonic() - begun
    yield from overwritten(new)
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
    found = next(
        a for a in bpy.context.window_manager.windows[0].screen.areas if a.type in ("DOPESHEET_EDITOR", "INFO")
    )
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


TASKS = ("VIEW", "EDIT", "SIMULATE", "RENDER")
"""The sidebar's tasks, from left to right."""
TASK_OF = (
    (r"boxes|find_actors|draw_box|track_this|keep_box|doubtful|unisim_tracks", ("VIEW",)),
    (r"show_sensor\(|unisim_actors|choose_actor|look_through|listed", ("VIEW", "EDIT")),
    (r"variant", ("EDIT", "RENDER")),
    (r"unisim_simulation|unisim\.simulate|drive_on|rollout|model", ("SIMULATE",)),
    (r"cancel_task|batch|parameter|open_report", ("SIMULATE", "RENDER")),
    (
        r"show_(ways|sensors|timeline|recorded|simulated|points)|unisim_view|points_|recorded_|unsupported|import_|drops=|birds_eye",
        ("VIEW",),
    ),
    (
        r"render_seq|open_output|play_result|_film|export_scen|\.train|make_lib|quality|passes|sequence_|unisim\.out",
        ("RENDER",),
    ),
)
"""Parts of the names of buttons, and the tasks whose panels have them; all others are among the edits."""


def choose_task(tasks: tuple[str, ...]) -> Iterator[float]:
    """Click on the first of some tasks in the sidebar, unless one of them is chosen."""
    manager, region = bpy.context.window_manager, region_of(view()[0], "UI")
    chosen = getattr(manager, "unisim_panels", None)  # earlier versions have none
    if chosen in (None, *tasks) or not bpy.context.scene.unisim.log:
        return
    yield from to(region.x + 0.04 * region.width, region.y + region.height / 2)
    yield from scroll("HOME")
    share = 0.04 + 0.86 * (TASKS.index(tasks[0]) + 0.5) / len(TASKS)
    met: dict[str, list[Place]] = {}
    found_at.clear()
    yield from first_of(view()[0], "UI", ("unisim_panels",), (share,), met)
    yield from to(*found_at.pop())
    yield from click()
    yield 0.5
    assert manager.unisim_panels == tasks[0], f"a click on {tasks[0]} shows {manager.unisim_panels}"


HEADERS = {
    "Insert": ("unisim.replace_appearance", 33),
    "Static Items": ("unisim.replace_appearance", 59),
    "Lamps": ("unisim.replace_appearance", 85),
    "Motion": ("unisim.replace_appearance", 111),
    "Actors": ("unisim.replace_appearance", 139),
    "Variants": ("unisim.replace_appearance", 167),
    "Sensors": ("unisim.replace_appearance", 195),
    "Ego": ("unisim.replace_appearance", 223),
    "Show": ("unisim.import_scene", 33),
    "Simulate": ("unisim_simulation.seed", -120),
    "Batch": ("unisim.export_scenario()", 112),
}
"""Where the header of each panel is: a button near it and how far below that, in pixels, while the panels between are
closed."""
BELOW = 250
"""How far below its header a button of a panel is looked for, in pixels."""


def open_panel(title: str, holds: str, column: float = 0.5) -> Iterator[float]:
    """Open a panel of the sidebar that is closed at first, by a click on its header, and scroll it up; one that is open
    already stays open.

    ``holds``: a part of the command or path of one of its upper buttons, which is in sight then; ``column``: where that
    is looked for, as a share of the sidebar's width."""
    region = region_of(view()[0], "UI")
    near, down = HEADERS[title]
    yield from place_of(near)
    x, y = found_at[0][0], found_at[0][1] - down
    y = yield from raised(y, region.y + BELOW)
    yield from look_below(y, holds, column)
    if not found_at:
        yield from to(x, y)
        yield from click()
        yield 0.6
    y = yield from raised(y, region.y + 3 * region.height // 4)
    yield from look_below(y, holds, column)
    assert found_at, f"a click on the header of {title} does not show {holds}"


def raised(y: int, least: int) -> Generator[float, None, int]:
    """Scroll the sidebar until what is at the height ``y`` is in sight and at ``least`` or above, or to the sidebar's
    end; return its height then."""
    region = region_of(view()[0], "UI")
    for wheel in ("WHEELUPMOUSE", "WHEELDOWNMOUSE"):
        while y > region.y + region.height - HEADER_HIGH if wheel == "WHEELUPMOUSE" else y < least:
            before = region.view2d.region_to_view(0, 0)[1]
            yield from to(
                region.x + 0.04 * region.width, region.y + region.height / 2
            )  # beside lists, which scroll themselves
            yield from key(wheel)
            yield 0.3
            moved = round(before - region.view2d.region_to_view(0, 0)[1])
            if not moved:
                break
            y += moved
    return y


def look_below(y: int, name: str, column: float) -> Iterator[float]:
    """Look for a button in the sidebar below a height; `found_at` is where it is met, or empty."""
    area, here = view()[0], [""]
    region = region_of(area, "UI")
    found_at.clear()
    for below in range(y - COARSE, max(y - BELOW, region.y), -COARSE):
        yield from held(area, region, region.x + column * region.width, below, here)
        if name in here[0]:
            found_at[:] = [(mouse[0], mouse[1])]
            return
