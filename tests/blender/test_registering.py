"""The add-on comes and goes without a trace."""

from __future__ import annotations

import re
import sys
from importlib.metadata import packages_distributions, requires
from pathlib import Path
from typing import Any

import bpy
from without_packages import run_without

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
from build_extension import COMPILED, PURE  # noqa: E402


def test_it_is_imported_with_what_blender_and_the_extension_have() -> None:
    """Blender's Python has numpy and what its own add-ons need; the extension brings wheels of its own."""
    names = ["numpy", "bpy", "unisim_blender", *PURE, *COMPILED, *(requires("bpy") or ())]
    there = {re.split(r"[^\w.-]", name)[0].split("==")[0].lower().replace("_", "-") for name in names}
    blocked = {
        package
        for package, distributions in packages_distributions().items()
        if not there & {name.lower().replace("_", "-") for name in distributions}
    }
    assert {"imageio_ffmpeg", "torch", "scipy", "safetensors"} <= blocked and not {"numpy", "PIL", "click"} & blocked
    done = run_without(tuple(blocked), "import unisim_blender.addon")
    assert done.returncode == 0, done.stderr


def test_ten_times_leaves_nothing(addon: Any) -> None:
    addon.unregister()

    def traces() -> tuple[int, ...]:
        classes = (
            bpy.types.Operator,
            bpy.types.Panel,
            bpy.types.PropertyGroup,
            bpy.types.RenderEngine,
            bpy.types.AddonPreferences,
        )
        ours = sum(
            1
            for kind in classes
            for cls in kind.__subclasses__()
            if cls.__module__.startswith(addon.__name__) and cls.is_registered
        )
        menus = sum(
            len(menu._dyn_ui_initialize())
            for menu in (bpy.types.TOPBAR_MT_file_import, bpy.types.TOPBAR_MT_file_export)
        )
        panels = sum("UNISIM" in getattr(panel, "COMPAT_ENGINES", ()) for panel in bpy.types.Panel.__subclasses__())
        handlers = [getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers)]
        handled = sum(len(found) for found in handlers if isinstance(found, list))
        return ours, menus, panels, handled, hasattr(bpy.types.Object, "unisim"), hasattr(bpy.types.Scene, "unisim")

    try:
        before = traces()
        assert before[0] == 0 and before[2] == 0
        for _ in range(10):
            addon.register()
            assert bpy.types.Scene.unisim
            addon.unregister()
        assert traces() == before
    finally:
        addon.register()
