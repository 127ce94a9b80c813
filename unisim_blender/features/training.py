"""Training of a neural scene from Blender, and the panel Training and Assets, a part of the panel Output."""

from pathlib import Path

import bpy
from bpy.props import EnumProperty, FloatProperty, IntProperty, StringProperty

from ..bridge.window import drive
from ..core.presets import PRESETS
from ..preferences import device, interpreter
from ..process.background import curve_icon, launch
from ..process.tasks import TrainingTask
from .operator_bases import Needing, nothing_runs, reporting
from .sidebar import DrivePanel, draw_task, optional_row, settings_column, switch_of, text_row

PREVIEW_S = 30.0
"""Between two previews, or longer where they would cost too much."""


class UNISIM_OT_train(Needing, bpy.types.Operator):
    """Train a neural scene on the imported log, in the background; an unfinished training in the folder is resumed"""

    bl_label = "Train Neural Scene"
    bl_options = {"REGISTER"}
    needs = (drive, nothing_runs)

    directory: StringProperty(name="Folder", description="Folder of the trained scene", subtype="DIR_PATH")
    minutes: FloatProperty(name="Minutes", description="Training time in minutes", default=60.0, min=0.1)
    width: IntProperty(name="Width", description="Image width in pixels", default=640, min=0, soft_min=8)
    has_width: switch_of(
        "width", lambda self: 640, "Set Width", "Train on images of this width; while off, of the recorded one"
    )
    preset: EnumProperty(
        name="Preset",
        description="Model configuration",
        items=[(preset.name, preset.title, preset.about) for preset in PRESETS.values() if not preset.is_baseline],
        default="small",
    )
    cameras: StringProperty(
        name="Cameras", description="Camera names separated by commas, or all; the one that faces ahead if empty"
    )
    frames: StringProperty(name="Frames", description="Frames as START:STOP:STEP", default="::2")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def draw(self, context: bpy.types.Context) -> None:
        column = settings_column(self.layout)
        column.prop(self, "preset")
        column.prop(self, "minutes")
        optional_row(column, "Width", "As recorded", self, "has_width", "width")
        text_row(column, "The one that faces ahead", self, "cameras")
        column.prop(self, "frames")

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        folder, log = Path(self.directory).absolute(), bpy.path.abspath(context.scene.unisim.log)
        arguments = ["train", log, "--out", str(folder), "--quiet", "--device", device(), "--preset", self.preset]
        arguments += ["--cameras", self.cameras] if self.cameras else []
        arguments += ["--frames", self.frames, "--minutes", str(self.minutes)]
        arguments += ["--preview", str(PREVIEW_S)]
        arguments += ["--width", str(self.width)] if self.width else []
        arguments += ["--resume"] if (folder / "checkpoint.safetensors").is_file() else []
        launch(TrainingTask(arguments, folder, self.minutes, interpreter()))
        return {"FINISHED"}


class UNISIM_PT_training(DrivePanel, bpy.types.Panel):
    """Training of the drive's scene, and its library of actors"""

    bl_label = "Training and Assets"
    bl_parent_id = "UNISIM_PT_output"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.operator("unisim.train", icon="MODIFIER")
        layout.operator("unisim.make_library", icon="ASSET_MANAGER")
        draw_task(layout, context.scene, TrainingTask)
        curve = curve_icon()
        if curve is not None:
            layout.template_icon(curve, scale=12.0)
