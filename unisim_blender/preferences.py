"""The add-on's preferences: which interpreter renders, and on what; default folders."""

from collections.abc import Callable

import bpy
from bpy.props import EnumProperty, StringProperty

from .translations import interface

DEVICES = (
    ("auto", "Automatic", "A GPU if the interpreter supports one, otherwise the CPU"),
    ("cpu", "CPU", "Render on the CPU"),
    ("cuda", "NVIDIA GPU", "Render on a GPU with CUDA"),
    ("mps", "Apple GPU", "Render on a GPU with Metal"),
)


SECTIONS: list[Callable[[bpy.types.UILayout, bpy.types.Context], None]] = []
"""What draws the further sections."""
unregister = SECTIONS.clear


class UniSimPreferences(bpy.types.AddonPreferences):
    """Preferences of the add-on."""

    bl_idname = __package__

    interpreter: StringProperty(
        name="Renderer's Python",
        description="Python interpreter with torch, for training; Blender's own renders if empty",
        subtype="FILE_PATH",
    )
    device: EnumProperty(name="Device", description="Device that the renderer uses", items=DEVICES, default="auto")

    logs_folder: StringProperty(
        name="Logs", description="Folder in which file browsers for logs and scenarios start", subtype="DIR_PATH"
    )
    output_folder: StringProperty(
        name="Output",
        description="Folder below which the output folder of a newly imported drive lies; //render beside the .blend if empty",
        subtype="DIR_PATH",
    )

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the interpreter, a test of it and what came of that, default folders, and the further sections."""
        hint = {"placeholder": interface("Blender's own")} if bpy.app.version >= (4, 3, 0) else {}
        self.layout.prop(self, "interpreter", **hint)
        self.layout.prop(self, "device")
        self.layout.operator("unisim.test_renderer")
        for line in context.window_manager.unisim_renderer.splitlines():
            self.layout.label(text=line)
        self.layout.label(text="Default Folders")
        self.layout.prop(self, "logs_folder")
        self.layout.prop(self, "output_folder")
        for draw in SECTIONS:
            draw(self.layout.column(), context)


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


def default_folder(name: str) -> str:
    """The default folder that the user chose for "logs" or "output", or ""."""
    folder = getattr(_preferences(), f"{name}_folder", "")
    return bpy.path.abspath(folder) if folder else ""
