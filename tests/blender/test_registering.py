"""The add-on comes and goes without a trace."""

from __future__ import annotations

from typing import Any

import bpy


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
