"""F1 and Online Manual on our buttons and settings: which section of the manual describes them.

The manual is an HTML page inside the extension, made of docs/blender.md by tools/build_manual.py. Each section has a small file
that leads to it, because not every system hands the part of an address after # to the browser.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import bpy

MANUAL = Path(__file__).resolve().parent / "manual"
"""Where the extension has its manual; sources that were not built have none."""
TOP = "index"

SECTIONS = (
    ("bpy.ops.unisim.import_*", "import"),
    ("bpy.ops.unisim.recorded_colours*", "view"),
    ("bpy.ops.unisim.show_points*", "view"),
    ("bpy.ops.unisim.test_renderer*", "install"),
    ("bpy.ops.unisim.check*", "edit"),
    ("bpy.ops.unisim.go_to*", "edit"),
    ("bpy.ops.unisim.train*", "train"),
    ("bpy.ops.unisim.render_sequence*", "render"),
    ("bpy.ops.unisim.cancel_task*", "render"),
    ("bpy.ops.unisim.open_output*", "render"),
    ("bpy.ops.unisim.play_result*", "render"),
    ("bpy.ops.unisim.export_scenario*", "render"),
    ("bpy.ops.unisim.make_library*", "edit"),
    ("bpy.ops.unisim.*", "edit"),
    ("bpy.types.unisimpreferences*", "install"),
    ("bpy.types.unisimscene.show_*", "view"),
    ("bpy.types.unisimscene.points_*", "view"),
    ("bpy.types.unisimscene.recorded_*", "view"),
    ("bpy.types.unisimscene.log*", "import"),
    ("bpy.types.unisimscene.scene*", "import"),
    ("bpy.types.unisimscene*", "render"),
    ("bpy.types.unisim*check*", "edit"),
    ("bpy.types.unisimwarning*", "edit"),
    ("bpy.types.unisim_pt_drive*", "import"),
    ("bpy.types.unisim_pt_show*", "view"),
    ("bpy.types.unisim_pt_output*", "render"),
    ("bpy.types.unisim_pt_render*", "render"),
    ("bpy.types.unisim_*", "edit"),
    ("bpy.types.unisim*", TOP),
    ("bpy.types.*.unisim*", TOP),
)
"""Patterns of Blender's names in lower case, and the section of the manual; the first that fits counts."""


def manual_map() -> tuple[str, tuple[tuple[str, str], ...]]:
    """Return the address of the manual's folder, and what of it describes what, as Blender asks for it."""
    return f"{MANUAL.as_uri()}/", tuple((pattern, f"{section}.html") for pattern, section in SECTIONS)


CLASSES = ()


def register() -> None:
    """Add the manual to Blender's, where it was built."""
    if (MANUAL / f"{TOP}.html").is_file():
        bpy.utils.register_manual_map(manual_map)


def unregister() -> None:
    """Take it away again."""
    with suppress(ValueError):  # it was not there
        bpy.utils.unregister_manual_map(manual_map)
