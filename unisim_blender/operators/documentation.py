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

OPERATORS = {
    "import": "import_*",
    "view": "recorded_colours* show_points*",
    "install": "test_renderer*",
    "check": "check* go_to*",
    "train": "train*",
    "sequences": "render_sequence* cancel_task* open_output* play_result* export_scenario*",
    "simulate": "simulate* drive_on* open_rollout* *model*",
    "variants": "*variant*",
    "edits-list": "*edit*",
    "motion": "aim_sensor* shift_actor* drag*",
    "sensors": "*sensor* add_* set_beams* *rig* look_through*",
    "meshes": "*mesh* *ego_body*",
    "find-an-actor": "choose_actor* *listed* *timeline* *filter* hide_actor*",
    "batches": "*batch* *parameter* open_report*",
    "edit": "*",
}
TYPES = {
    "install": "unisimpreferences*",
    "view": "unisimscene.show_* unisimscene.points_* unisimscene.recorded_* unisim_pt_show*",
    "import": "unisimscene.log* unisimscene.scene* unisim_pt_drive*",
    "sequences": "unisimscene.sequence_* unisimscene.out* unisim_pt_output*",
    "render": "unisimscene* unisim_pt_render*",
    "check": "unisimcheck* unisimwarning* unisim_pt_warnings*",
    "simulate": "unisimsimulation* unisimmodel* unisim_pt_simulat* unisim_pt_scores*",
    "batches": "unisimbatch* unisimparameter* unisim_pt_batch*",
    "variants": "unisim_pt_variants*",
    "edits-list": "unisim_pt_edits*",
    "sensors": "unisim_pt_sensors*",
    "motion": "unisim_pt_motion*",
    "find-an-actor": "unisim_pt_actors*",
    "edit": "unisim_*",
    INDEX: "unisim* *.unisim*",
}
"""Sections of the manual, and patterns of what they describe: of our operators and of Blender's types in lower case. The first
that fits counts."""


def manual_map() -> tuple[str, tuple[tuple[str, str], ...]]:
    """Return the address of the manual's folder, and what of it describes what, as Blender asks for it."""
    return f"{MANUAL.as_uri()}/", tuple(
        (f"{path}.{pattern}", f"{section}.html")
        for path, sections in (("bpy.ops.unisim", OPERATORS), ("bpy.types", TYPES))
        for section, patterns in sections.items()
        for pattern in patterns.split()
    )


def register() -> None:
    """Add the manual to Blender's, where it was built."""
    if (MANUAL / f"{INDEX}.html").is_file():
        bpy.utils.register_manual_map(manual_map)


def unregister() -> None:
    """Take it away again."""
    with suppress(ValueError):  # it was not there
        bpy.utils.unregister_manual_map(manual_map)
