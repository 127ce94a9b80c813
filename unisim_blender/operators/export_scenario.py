"""File > Export > Scenario: what the scene stands for, as a file that renders headless."""

from pathlib import Path

import bpy
from bpy.props import StringProperty
from bpy_extras.io_utils import ExportHelper

from ..bridge.clock import Clock
from ..bridge.reading import read_scenario
from ..bridge.sampling import sample_all
from ..bridge.source import source_of
from ..bridge.writing import write_scenario
from ..core.errors import UnisimError
from ..core.scenario.types import FrameRange, Outputs, Scenario
from ..registering import add, take_away
from ..translations import message
from .polling import allowed, drive


def scenario_of(scene: bpy.types.Scene, path: Path) -> Scenario:
    """The scenario that a Blender scene stands for, as it would be written to ``path``. Raises `UnisimError`."""
    source = source_of(scene)
    clock = Clock.of(source.drive)
    settings = scene.unisim
    all_frames = scene.frame_start <= clock.frames[0] and scene.frame_end >= clock.frames[-1] and scene.frame_step == 1
    frames = None if all_frames else FrameRange(scene.frame_start, scene.frame_end + 1, scene.frame_step)
    passes = ("rgb", *(name for name in ("depth", "normal", "instance", "opacity", "support") if name in settings.passes))
    outputs = Outputs(passes=passes, quality=settings.quality, contact_shadows=settings.contact_shadows or None)
    return read_scenario(sample_all(scene, clock), source, path, frames, outputs)


class UNISIM_OT_export_scenario(bpy.types.Operator, ExportHelper):
    """Write the edits of the scene to a scenario file for the command unisim render"""

    bl_idname = "unisim.export_scenario"
    bl_label = "Export Scenario"
    bl_options = {"REGISTER"}

    filename_ext = ".json"
    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A drive has to be there."""
        return allowed(cls, drive(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Read the scene and write the file."""
        path = Path(self.filepath).absolute()
        try:
            scenario = scenario_of(context.scene, path)
            write_scenario(scenario, path)
        except (UnisimError, OSError) as fault:
            self.report({"ERROR"}, str(fault))
            return {"CANCELLED"}
        self.report({"INFO"}, message("Scenario written to {path} (edits: {count})", count=len(scenario.edits), path=path))
        return {"FINISHED"}


def draw_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """A line in File > Export."""
    self.layout.operator(UNISIM_OT_export_scenario.bl_idname, text="UniSim Scenario (.json)")


CLASSES = (UNISIM_OT_export_scenario,)


def register() -> None:
    """Add the operator and its line in the menu."""
    add(CLASSES)
    bpy.types.TOPBAR_MT_file_export.append(draw_menu)


def unregister() -> None:
    """Take them away."""
    bpy.types.TOPBAR_MT_file_export.remove(draw_menu)
    take_away(CLASSES)
