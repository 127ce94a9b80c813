"""Why something failed: a dialog that stays, wraps the sentence, copies it, and has a button for what mends it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy
from bpy.props import StringProperty

from ..bridge.window import label_rows
from ..editing.texts import translatable
from ..process.packages import PACKAGES
from ..translations import interface

DIALOG_WIDTH, MARGIN, PANEL_MARGIN, LEAST_WIDTH = 520, 40, 95, 105
"""Of the dialog, of what of it and of a panel is not text, and the least that texts in a panel are made to fit, in pixels of an
ordinary display."""


REMEDIES = {
    "interpreter": ("unisim.show_preferences", translatable("Choose Interpreter"), "PREFERENCES"),
    "log": ("unisim.locate_log", translatable("Choose Folder of the Log"), "FILE_FOLDER"),
    **dict.fromkeys(PACKAGES, ("unisim.install_package", translatable("Install {package}"), "IMPORT")),
}
"""The dialog's buttons by a `UnisimError.remedy`: their operators, texts and icons."""


def fail(operator: Any, fault: Exception) -> set[str]:
    """Say why an operator ends: to whoever pressed it in a dialog, to scripts as an error. Return its result."""
    if bpy.app.background or not operator.options.is_invoke or operator.options.is_repeat:
        operator.report({"ERROR"}, str(fault))
    else:
        operator.report({"WARNING"}, str(fault))  # an error would open a menu over the dialog
        title, remedy = interface(operator.bl_label), getattr(fault, "remedy", "")

        # once the operator, and the file browser that called it, have ended
        def show() -> None:
            with bpy.context.temp_override(window=bpy.context.window or bpy.context.window_manager.windows[0]):
                bpy.ops.unisim.show_problem("INVOKE_DEFAULT", title=title, text=str(fault), remedy=remedy)

        bpy.app.timers.register(show, first_interval=0.0)
    return {"CANCELLED"}


def problem_button(layout: Any, title: str, text: str, remedy: str, label: str = "") -> None:
    """Draw the button that opens the dialog."""
    button = layout.operator("unisim.show_problem", text=label, icon="ERROR")
    button.title, button.text, button.remedy = title, text, remedy


def draw_problem(layout: Any, text: str, icon: str = "NONE") -> None:
    """Draw a sentence into a panel, in as many lines as it takes."""
    draw_rows(layout.column(align=True), panel_rows(text), icon)


def panel_rows(text: str, beside: float = 0.0) -> list[str]:
    """Return a text in rows of a panel's labels, ``beside`` pixels of an ordinary display shorter in the first one."""
    region = bpy.context.region
    width = region.width / bpy.context.preferences.system.ui_scale if region is not None else DIALOG_WIDTH
    room = max(width - PANEL_MARGIN, LEAST_WIDTH)
    return label_rows(text, room, room - beside)


def draw_rows(column: Any, rows: Iterable[str], icon: str = "NONE") -> None:
    """Draw rows of a text, the first with an icon."""
    for row in rows:
        column.label(text=row, translate=False, icon=icon)
        icon = "BLANK1" if icon != "NONE" else icon


class UNISIM_OT_show_problem(bpy.types.Operator):
    """Show why it failed, and what can be done"""

    bl_label = "Problem"
    bl_options = {"INTERNAL"}

    title: StringProperty(options={"SKIP_SAVE", "HIDDEN"})
    text: StringProperty(options={"SKIP_SAVE", "HIDDEN"})
    remedy: StringProperty(options={"SKIP_SAVE", "HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_props_dialog(self, width=DIALOG_WIDTH, title=self.title)

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        draw_rows(layout.column(align=True), label_rows(self.text, DIALOG_WIDTH - MARGIN))
        layout.separator()
        layout.operator("unisim.copy_text", text="Copy Message", icon="COPYDOWN").text = self.text
        operator, text, icon = REMEDIES.get(self.remedy, ("", "", "NONE"))
        text = interface(text, package=self.remedy) if text else ""
        if hasattr(layout, "template_popup_confirm"):
            button = layout.template_popup_confirm(operator, text=text, icon=icon, cancel_text=interface("Close"))
        elif operator:  # versions without it have OK and Cancel of their own
            button = layout.operator(operator, text=text, icon=icon)
        if self.remedy in PACKAGES:
            button.package = self.remedy

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Blender asks for it where the dialog is confirmed by a key."""
        return {"FINISHED"}


class UNISIM_OT_copy_text(bpy.types.Operator):
    """Copy the whole message to the clipboard"""

    bl_label = "Copy Message"
    bl_options = {"INTERNAL"}

    text: StringProperty(options={"SKIP_SAVE", "HIDDEN"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.window_manager.clipboard = self.text
        return {"FINISHED"}


class UNISIM_OT_show_preferences(bpy.types.Operator):
    """Open the preferences of UniSim: interpreter, optional packages, folders, caches and shortcuts"""

    bl_label = "UniSim Preferences"

    def execute(self, context: bpy.types.Context) -> set[str]:
        return bpy.ops.preferences.addon_show(module=__package__.rpartition(".")[0])
