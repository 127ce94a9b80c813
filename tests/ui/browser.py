"""A file or folder chosen in Blender's file browser, which has a window of its own, with mouse and keys."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import bpy
from hands import click, key, to, window, write
from session import area, screenshot, until

ACCEPT = 0.92
"""Where in the file browser's lower row the button is that accepts, as a share of its width."""


def menu_entry(words: str) -> Iterator[float]:
    """Click on File in the window's upper left corner, search its menus with the space bar, and
    choose what is found."""
    first = bpy.context.window_manager.windows[0]
    yield from to(46, first.height - 14)
    yield from click()
    yield 0.5
    yield from key("SPACE", " ")
    yield 0.3
    yield from write(words)
    yield 0.5
    yield from key("RET")


def choose_path(path: Path, folder: bool = False) -> Iterator[float]:
    """In the file browser that has opened, go to a path's folder, type the file's name, and accept.

    ``folder``: whether the path is itself the folder that is wanted."""
    yield from until(lambda: len(bpy.context.window_manager.windows) > 1, "no file browser opens")
    yield 1.0
    window[0] = len(bpy.context.window_manager.windows) - 1
    try:
        browser = next(
            found
            for found in bpy.context.window_manager.windows[window[0]].screen.areas
            if found.type == "FILE_BROWSER"
        )
        regions = {region.type: region for region in browser.regions}
        listed = regions["WINDOW"]
        yield from to(listed.x + listed.width / 2, listed.y + listed.height / 2)
        yield from key("L", ctrl=True)
        yield 0.2
        yield from key("A", ctrl=True)
        yield from write(str(path if folder else path.parent))
        yield from key("RET")
        yield 0.7
        accept = regions["EXECUTE"]
        if folder:
            screenshot(f"browser_{path.stem}")
            yield from to(accept.x + ACCEPT * accept.width, accept.y + accept.height / 2)
            for _ in range(3):  # in Blender 5.2, the first click leaves the field of the path
                yield 0.3
                yield from click()
                yield 1.2
                if len(bpy.context.window_manager.windows) == 1:
                    break
        else:
            yield from to(accept.x + accept.width / 4, accept.y + accept.height / 2)
            yield from click()
            yield 0.2
            yield from key("A", ctrl=True)
            yield from write(path.name)
            yield from key("RET")
            yield 0.3
            screenshot(f"browser_{path.stem}")
            if len(bpy.context.window_manager.windows) > 1:  # in Blender 5.2, Enter in the field of the name accepts it
                yield from to(listed.x + listed.width / 2, listed.y + listed.height / 2)
                yield from key("RET")
    finally:
        window[0] = 0
    yield from until(lambda: len(bpy.context.window_manager.windows) == 1, "the file browser stays open", 10)
    found = area("VIEW_3D")
    yield from to(found.x + found.width / 2, found.y + found.height / 2)


MENUS = {"View": 0.145, "Select": 0.18, "Add": 0.213, "Object": 0.247}
"""Where the 3D view's header shows its menus, as shares of a width of 1322 pixels."""


def header_menu(name: str, words: str) -> Iterator[float]:
    """Click on a menu of the 3D view's header, search it with the space bar, and choose what is found."""
    found = area("VIEW_3D")
    header = next(region for region in found.regions if region.type == "HEADER")
    yield from to(header.x + MENUS[name] * 1322, header.y + header.height / 2)
    yield from click()
    yield 0.5
    yield from key("SPACE", " ")
    yield 0.3
    yield from write(words)
    yield 0.5
    screenshot(f"menu_{name}")
    yield from key("RET")
    yield 0.3
