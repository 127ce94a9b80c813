"""The sidebar's tasks and panels, switches of numbers, and descriptions of all that people can press."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import pytest

from unisim_blender.features import sidebar
from unisim_blender.features.drive import export_operators, import_operators
from unisim_blender.operators import menus

ROOT = Path(__file__).parents[2]
WITHOUT_TASK = {"UNISIM_PT_tasks", "UNISIM_PT_first_steps"}
"""Panels that every task has."""


def panels() -> list[Any]:
    """Return the sidebar's panels that are no part of another one."""
    every = [getattr(bpy.types, name) for name in dir(bpy.types) if name.startswith("UNISIM_PT_")]
    return [
        panel
        for panel in every
        if panel.bl_space_type == "VIEW_3D" and panel.bl_region_type == "UI" and not getattr(panel, "bl_parent_id", "")
    ]


def test_each_panel_belongs_to_a_task(street: Any) -> None:
    names = {item[0] for item in sidebar.TASKS}
    assert all(set(panel.tasks) <= names for panel in panels())
    assert {panel.__name__ for panel in panels() if not panel.tasks} == WITHOUT_TASK
    manager, shown = bpy.context.window_manager, {}
    for task in names:
        manager.unisim_panels = task
        shown[task] = {panel.__name__ for panel in panels() if panel.poll(bpy.context)}
    assert all("UNISIM_PT_tasks" in there and 3 <= len(there) <= 9 for there in shown.values()), shown
    assert set.union(*shown.values()) == {panel.__name__ for panel in panels()}
    assert "UNISIM_PT_actor" not in shown["RENDER"] and "UNISIM_PT_output" not in shown["EDIT"]
    manager.property_unset("unisim_panels")


def test_without_a_drive_there_are_no_tasks(scene: Any) -> None:
    for task, *_ in sidebar.TASKS:
        bpy.context.window_manager.unisim_panels = task
        assert [panel.__name__ for panel in panels() if panel.poll(bpy.context)] == ["UNISIM_PT_first_steps"]
    bpy.context.window_manager.property_unset("unisim_panels")


@pytest.mark.parametrize(
    ("group", "switch", "member", "first"),
    [
        (lambda: bpy.context.scene.unisim, "has_sequence_width", "sequence_width", 1600),
        (lambda: bpy.context.scene.unisim_batch, "has_jobs", "jobs", None),
        (lambda: bpy.context.window_manager.unisim_actors, "is_near", "within_m", 50.0),
    ],
)
def test_a_number_that_files_have_as_zero_is_a_switch(
    scene: Any, group: Any, switch: str, member: str, first: float | None
) -> None:
    scene.render.resolution_x = 1600
    setattr(group(), member, 0)
    assert not getattr(group(), switch)
    setattr(group(), switch, True)
    value = getattr(group(), member)
    assert value == first if first is not None else value >= 1
    setattr(group(), member, 7)  # as in a file of an earlier version
    assert getattr(group(), switch)
    setattr(group(), switch, True)
    assert getattr(group(), member) == 7
    setattr(group(), switch, False)
    assert getattr(group(), member) == 0


class MenuLines:
    """A layout that notes what menus draw, and those below them."""

    def __init__(self, context: Any) -> None:
        self.operators: set[str] = set()
        self.context, self.layout, self.active, self.enabled = context, self, True, True

    def operator(self, name: str, *_: Any, **__: Any) -> Any:
        """An operator's line; what is set on it is lost."""
        self.operators.add(name)
        return SimpleNamespace()

    operator_menu_enum = operator

    def menu(self, name: str, **_: Any) -> None:
        """The lines of a menu below."""
        cls = getattr(bpy.types, name)
        cls.draw(self, self.context)

    def operator_enum(self, name: str, *_: Any, **__: Any) -> None:
        """An operator's lines."""
        self.operators.add(name)

    def __getattr__(self, name: str) -> Any:
        return lambda *_, **__: self


ROW = (
    "add_parameter clear_cache compare_variant forget_model go_to go_to_edit hide_rollout install_package "
    "look_through mute_edit remove_package remove_parameter remove_rig revert_edit same_model show_sensor "
    "show_variant test_renderer use_frame_range "
)
"""Operators of a row of a list or of the preferences."""


def test_the_menu_search_finds_all_operators(street: Any) -> None:
    lines = MenuLines(bpy.context)
    for draw in (
        menus.draw_view_menu, menus.draw_object_menu, menus.draw_add_menu, menus.draw_render_menu,
        import_operators.draw_menu, export_operators.draw_menu,
    ):  # fmt: skip
        draw(lines, bpy.context)
    assert all(hasattr(bpy.types, f"UNISIM_OT_{name.partition('.')[2]}") for name in lines.operators)
    every = [getattr(bpy.types, name) for name in dir(bpy.types) if name.startswith("UNISIM_OT_")]
    wanted = {cls.bl_idname for cls in every if "INTERNAL" not in getattr(cls, "bl_options", ())}
    assert wanted - lines.operators == {f"unisim.{name}" for name in ROW.split()}


def test_all_that_can_be_pressed_is_described(addon: Any) -> None:
    spec = importlib.util.spec_from_file_location("translations_tool", ROOT / "tools" / "translations.py")
    assert spec is not None and spec.loader is not None
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    bare = []
    for kind in ("Operator", "PropertyGroup", "AddonPreferences", "Menu"):
        for cls in tool.ours(kind):
            rna = cls.bl_rna
            if kind == "Operator":
                rna = getattr(bpy.ops.unisim, cls.bl_idname.partition(".")[2]).get_rna_type()
            if kind in ("Operator", "Menu") and not (rna.description if kind == "Operator" else cls.bl_description):
                bare.append(cls.__name__)
            named = {name for base in cls.__mro__ for name in base.__dict__.get("__annotations__", {})}
            for name, prop in rna.properties.items():
                if name in named and not prop.is_hidden and prop.type not in ("POINTER", "COLLECTION"):
                    if prop.name != name and not prop.description:  # without a name, no layout has it
                        bare.append(f"{cls.__name__}.{name}")
    assert not bare, sorted(bare)
