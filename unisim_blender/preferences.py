"""The add-on's preferences: which interpreter renders, and on what."""

import bpy
from bpy.props import EnumProperty, StringProperty

from .translations import interface

DEVICES = (
    ("auto", "Automatic", "A GPU if the interpreter supports one, otherwise the CPU"),
    ("cpu", "CPU", "Render on the CPU"),
    ("cuda", "NVIDIA GPU", "Render on a GPU with CUDA"),
    ("mps", "Apple GPU", "Render on a GPU with Metal"),
)


class UniSimPreferences(bpy.types.AddonPreferences):
    """Preferences of the add-on: the interpreter that renders, and its device."""

    bl_idname = __package__

    interpreter: StringProperty(
        name="Renderer's Python",
        description="Python interpreter with torch, for training and GPU rendering; Blender's own renders on the CPU if empty",
        subtype="FILE_PATH",
    )
    device: EnumProperty(name="Device", description="Device that the renderer uses", items=DEVICES, default="auto")

    def draw(self, context: bpy.types.Context) -> None:
        """The choice, a test of it, and what came of that."""
        hint = {"placeholder": interface("Blender's own")} if bpy.app.version >= (4, 3, 0) else {}
        self.layout.prop(self, "interpreter", **hint)
        self.layout.prop(self, "device")
        self.layout.operator("unisim.test_renderer")
        for line in context.window_manager.unisim_renderer.splitlines():
            self.layout.label(text=line)


def _preferences() -> UniSimPreferences | None:
    addon = bpy.context.preferences.addons.get(__package__)
    return None if addon is None else addon.preferences


def interpreter() -> str:
    """The interpreter that the user chose, or ""."""
    preferences = _preferences()
    return bpy.path.abspath(preferences.interpreter) if preferences is not None and preferences.interpreter else ""


def device() -> str:
    """The device that the user chose."""
    preferences = _preferences()
    return "auto" if preferences is None else preferences.device


CLASSES = (UniSimPreferences,)
