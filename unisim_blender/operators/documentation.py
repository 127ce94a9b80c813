"""F1 and Online Manual on our buttons and settings: which section of the manual describes them.

The manual is an HTML page inside the extension, made of docs/reference/blender.md by tools/build_manual.py. Each
section has a small file that leads to it, because not every system hands the part of an address after # to the browser.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import bpy

MANUAL = Path(__file__).resolve().parents[1] / "manual"
"""The folder of the extension's manual; sources that were not built have none."""
INDEX = "index"

SECTIONS = (
    ("bpy.ops.unisim.import_*", "import"),
    ("bpy.ops.unisim.recorded_colours*", "view"),
    ("bpy.ops.unisim.show_points*", "view"),
    ("bpy.ops.unisim.test_renderer*", "install"),
    ("bpy.ops.unisim.check*", "check"),
    ("bpy.ops.unisim.go_to*", "check"),
    ("bpy.ops.unisim.train*", "train"),
    ("bpy.ops.unisim.render_sequence*", "sequences"),
    ("bpy.ops.unisim.cancel_task*", "sequences"),
    ("bpy.ops.unisim.open_output*", "sequences"),
    ("bpy.ops.unisim.play_result*", "sequences"),
    ("bpy.ops.unisim.export_scenario*", "sequences"),
    ("bpy.ops.unisim.simulate*", "simulate"),
    ("bpy.ops.unisim.drive_on*", "simulate"),
    ("bpy.ops.unisim.open_rollout*", "simulate"),
    ("bpy.ops.unisim.*model*", "simulate"),
    ("bpy.ops.unisim.*variant*", "variants"),
    ("bpy.ops.unisim.*edit*", "edits-list"),
    ("bpy.ops.unisim.aim_sensor*", "motion"),
    ("bpy.ops.unisim.*sensor*", "sensors"),
    ("bpy.ops.unisim.add_*", "sensors"),
    ("bpy.ops.unisim.set_beams*", "sensors"),
    ("bpy.ops.unisim.*mesh*", "meshes"),
    ("bpy.ops.unisim.*ego_body*", "meshes"),
    ("bpy.ops.unisim.shift_actor*", "motion"),
    ("bpy.ops.unisim.drag*", "motion"),
    ("bpy.ops.unisim.*rig*", "sensors"),
    ("bpy.ops.unisim.look_through*", "sensors"),
    ("bpy.ops.unisim.choose_actor*", "find-an-actor"),
    ("bpy.ops.unisim.*listed*", "find-an-actor"),
    ("bpy.ops.unisim.*timeline*", "find-an-actor"),
    ("bpy.ops.unisim.*filter*", "find-an-actor"),
    ("bpy.ops.unisim.hide_actor*", "find-an-actor"),
    ("bpy.ops.unisim.*batch*", "batches"),
    ("bpy.ops.unisim.*parameter*", "batches"),
    ("bpy.ops.unisim.open_report*", "batches"),
    ("bpy.ops.unisim.*", "edit"),
    ("bpy.types.unisimpreferences*", "install"),
    ("bpy.types.unisimscene.show_*", "view"),
    ("bpy.types.unisimscene.points_*", "view"),
    ("bpy.types.unisimscene.recorded_*", "view"),
    ("bpy.types.unisimscene.log*", "import"),
    ("bpy.types.unisimscene.scene*", "import"),
    ("bpy.types.unisimscene.sequence_*", "sequences"),
    ("bpy.types.unisimscene.out*", "sequences"),
    ("bpy.types.unisimscene*", "render"),
    ("bpy.types.unisimcheck*", "check"),
    ("bpy.types.unisimwarning*", "check"),
    ("bpy.types.unisim_pt_warnings*", "check"),
    ("bpy.types.unisim_pt_drive*", "import"),
    ("bpy.types.unisim_pt_show*", "view"),
    ("bpy.types.unisim_pt_output*", "sequences"),
    ("bpy.types.unisimsimulation*", "simulate"),
    ("bpy.types.unisimbatch*", "batches"),
    ("bpy.types.unisimparameter*", "batches"),
    ("bpy.types.unisim_pt_batch*", "batches"),
    ("bpy.types.unisimmodel*", "simulate"),
    ("bpy.types.unisim_pt_simulat*", "simulate"),
    ("bpy.types.unisim_pt_scores*", "simulate"),
    ("bpy.types.unisim_pt_render*", "render"),
    ("bpy.types.unisim_pt_variants*", "variants"),
    ("bpy.types.unisim_pt_edits*", "edits-list"),
    ("bpy.types.unisim_pt_sensors*", "sensors"),
    ("bpy.types.unisim_pt_motion*", "motion"),
    ("bpy.types.unisim_pt_actors*", "find-an-actor"),
    ("bpy.types.unisim_*", "edit"),
    ("bpy.types.unisim*", INDEX),
    ("bpy.types.*.unisim*", INDEX),
)
"""Patterns of Blender's names in lower case, and the section of the manual; the first that fits counts."""


def manual_map() -> tuple[str, tuple[tuple[str, str], ...]]:
    """Return the address of the manual's folder, and what of it describes what, as Blender asks for it."""
    return f"{MANUAL.as_uri()}/", tuple((pattern, f"{section}.html") for pattern, section in SECTIONS)


def register() -> None:
    """Add the manual to Blender's, where it was built."""
    if (MANUAL / f"{INDEX}.html").is_file():
        bpy.utils.register_manual_map(manual_map)


def unregister() -> None:
    """Take it away again."""
    with suppress(ValueError):  # it was not there
        bpy.utils.unregister_manual_map(manual_map)
