"""Sections of the preferences: optional packages, and caches."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import bpy
from bpy.props import StringProperty

from ..bridge.window import label_rows, redraw
from ..core.errors import UnisimError
from ..core.files import cache_folder
from ..core.remote.limit import cache_sizes, clear_cache
from ..preferences import SECTIONS
from ..process import interpreters
from ..process.background import launch, newest
from ..process.packages import PACKAGES, PackageTask, remove
from ..translations import interface, localized, message
from .operator_bases import AtOnce, Needing, in_thread, nothing_runs, reporting
from .problems import MARGIN, draw_rows
from .sidebar import draw_task

POLL_S, MB = 0.3, 1e6
DIALOG_WIDTH = 480
"""Of the question before an installation, in pixels of an ordinary display."""
_measured: list[Future[dict[str, int]]] = []
"""The newest measurement of the caches: their bytes by name."""


def measure() -> None:
    """Measure the caches in a thread, and draw the preferences again."""
    _measured[:] = [ThreadPoolExecutor(1).submit(cache_sizes)]
    if not bpy.app.background:
        bpy.app.timers.register(lambda: redraw("PREFERENCES") if _measured[0].done() else POLL_S, first_interval=POLL_S)


def draw_packages(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the optional packages, which of them are there, and what installs and removes them."""
    layout.label(text="Optional Packages")
    if PackageTask in newest:
        draw_task(layout, context.scene, PackageTask)
    for package in PACKAGES.values():
        row = layout.split(factor=0.75)
        about = interface("{package}: {use}", package=package.name, use=localized(package.use))
        row.label(text=about, translate=False, icon="CHECKMARK" if package.available else "BLANK1")
        if package.installed:
            row.operator("unisim.remove_package", text="Remove", icon="TRASH").package = package.name
        elif package.available:
            row.label(text="Part of Blender's Python")
        else:
            row.operator("unisim.install_package", text="Install", icon="IMPORT").package = package.name


def draw_caches(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw how large the caches are, and what clears them."""
    if not _measured:
        measure()
    sizes = _measured[0].result() if _measured[0].done() else {}
    split = layout.split(factor=0.75)
    text = interface("Caches: {size:.0f} MB in {folder}", size=sum(sizes.values()) / MB, folder=cache_folder())
    split.label(text=text if _measured[0].done() else interface("Measuring…"), translate=False)
    split.operator("unisim.clear_cache", text="Clear", icon="TRASH")
    parts = ", ".join(f"{name} {size / MB:.0f} MB" for name, size in sorted(sizes.items()) if size >= MB)
    layout.label(text=parts or "–", translate=False)


class _OfPackage(Needing):
    """Base of operators on an optional package."""

    needs = (nothing_runs,)
    package: StringProperty(options={"SKIP_SAVE", "HIDDEN"})


class UNISIM_OT_install_package(_OfPackage, bpy.types.Operator):
    """Download an optional package from the package index with pip, into the folder of this extension, after a question"""

    bl_label = "Install Optional Package"
    bl_options = {"REGISTER"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_props_dialog(self, width=DIALOG_WIDTH, confirm_text="Install")

    def draw(self, context: bpy.types.Context) -> None:
        package, column = PACKAGES[self.package], self.layout.column(align=True)
        asked = interface(
            "Downloads {package} (about {size} MB) from the package index by pip, and installs it into {folder}",
            package=package.name, size=package.size_mb, folder=package.folder,
        )  # fmt: skip
        draw_rows(column, label_rows(asked, DIALOG_WIDTH - MARGIN))
        if not bpy.app.online_access:
            column.label(text="Blender is not allowed to go online", icon="ERROR")
            column.prop(context.preferences.system, "use_online_access")

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        if not bpy.app.online_access:
            raise UnisimError(message("Blender is not allowed to go online"))
        interpreters.PACKAGES.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=".installing-", dir=interpreters.PACKAGES))
        launch(PackageTask([], folder, 1.0, package=PACKAGES[self.package]))
        return {"FINISHED"}


class UNISIM_OT_remove_package(_OfPackage, bpy.types.Operator):
    """Delete an optional package from the folder of this extension"""

    bl_label = "Remove Optional Package"
    bl_options = {"REGISTER"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_confirm(self, event)

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        remove(PACKAGES[self.package])
        return {"FINISHED"}


class UNISIM_OT_clear_cache(Needing, AtOnce, bpy.types.Operator):
    """Delete prepared surfels, thumbnails, copies of inputs and other results that are made again when they are needed"""

    bl_label = "Clear Caches"
    bl_options = {"REGISTER"}
    needs = (nothing_runs,)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.by_hand = True
        return context.window_manager.invoke_confirm(self, event, title=self.bl_label, message=self.__doc__ or "")

    def work(self, context: bpy.types.Context) -> Iterator[str | None]:
        yield from in_thread(clear_cache)
        measure()


def register() -> None:
    """Add the sections."""
    SECTIONS.extend((draw_packages, draw_caches))
