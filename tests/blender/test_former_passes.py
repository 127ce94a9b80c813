"""A .blend file holds the passes of a sequence as flags: a file saved when a pass had another name opens with
the same choice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

FORMER = tuple((name, name, "") for name in ("depth", "normal", "instance", "opacity", "support"))


# as much of the scene's properties as held the passes, when ``unsupported`` was called ``support``
PASSES = bpy.props.EnumProperty(items=FORMER, options={"ENUM_FLAG"}, default={"depth"})
FormerScene = type("FormerScene", (bpy.types.PropertyGroup,), {"__annotations__": {"passes": PASSES}})


def test_a_file_with_the_former_name_has_the_same_choice(addon: Any, scene: Any, tmp_path: Path) -> None:
    files = {name: str(tmp_path / f"{name}.blend") for name in ("chosen", "others")}
    addon.unregister()
    try:
        bpy.utils.register_class(FormerScene)
        bpy.types.Scene.unisim = bpy.props.PointerProperty(type=FormerScene)
        for name, passes in (("chosen", {"normal", "support"}), ("others", {"depth", "opacity"})):
            bpy.context.scene.unisim.passes = passes
            bpy.ops.wm.save_as_mainfile(filepath=files[name])
        del bpy.types.Scene.unisim
        bpy.utils.unregister_class(FormerScene)
    finally:
        addon.register()
    bpy.ops.wm.open_mainfile(filepath=files["chosen"])
    assert bpy.context.scene.unisim.passes == {"normal", "unsupported"}
    bpy.ops.wm.open_mainfile(filepath=files["others"])
    assert bpy.context.scene.unisim.passes == {"depth", "opacity"}


def test_flags_keep_their_numbers(scene: Any) -> None:
    items = scene.unisim.bl_rna.properties["passes"].enum_items
    assert {item.identifier: item.value for item in items} == {
        "depth": 1, "normal": 2, "instance": 4, "opacity": 8, "unsupported": 16, "confidence": 32,
    }  # fmt: skip
