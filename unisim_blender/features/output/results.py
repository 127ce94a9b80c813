"""What a sequence left in its folder: the folder opened, its images played."""

import subprocess
from pathlib import Path

import bpy
from bpy.props import EnumProperty

from ...bridge.window.polling import Need, allowed, drive
from ...editing.images.rendered import Frames, player_command, rendered_cameras
from ...translations import message

_shown: list[tuple[str, str, str]] = []
"""What a menu shows has to be kept: Blender does not."""


def output_folder(scene: bpy.types.Scene) -> Path | None:
    """Return the folder that the scene's sequences are written to; None while it is not known."""
    out = scene.unisim.out
    if not out or (out.startswith("//") and not bpy.data.filepath):
        return None
    return Path(bpy.path.abspath(out)).absolute()


def results_of(scene: bpy.types.Scene) -> dict[str, Frames]:
    """Return the finished images of the scene's output folder by camera."""
    folder = output_folder(scene)
    return {} if folder is None else rendered_cameras(folder)


def camera_items(self: bpy.types.Operator, context: bpy.types.Context) -> list[tuple[str, str, str]]:
    """The cameras that have images, for a menu."""
    found = results_of(context.scene)
    _shown[:] = [(name, name, message("Images: {count}", count=frames.count)) for name, frames in found.items()]
    return _shown or [("", "None", "")]


def folder_known(context: bpy.types.Context) -> Need:
    """The output folder is known."""
    return output_folder(
        context.scene
    ) is not None, "Save the .blend first, or choose a folder that does not depend on it"


class UNISIM_OT_open_output(bpy.types.Operator):
    """Open the output folder in the system's file browser"""

    bl_idname = "unisim.open_output"
    bl_label = "Open Folder"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The folder has to be there."""
        folder = output_folder(context.scene)
        there = folder is not None and folder.is_dir()
        return allowed(
            cls, drive(context), folder_known(context), (there, "The output folder does not exist yet: render first")
        )

    def execute(self, context: bpy.types.Context) -> set[str]:
        """As Blender opens folders."""
        return bpy.ops.wm.path_open(filepath=str(output_folder(context.scene)))


class UNISIM_OT_play_result(bpy.types.Operator):
    """Play the rendered images of a camera in Blender's animation player"""

    bl_idname = "unisim.play_result"
    bl_label = "Play Result"
    bl_options = {"REGISTER"}

    camera: EnumProperty(name="Camera", description="Camera whose images are played", items=camera_items)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Images have to be there, and a Blender that plays them."""
        return allowed(
            cls,
            drive(context),
            folder_known(context),
            (results_of(context.scene), "The output folder has no camera images yet: render a sequence first"),
            (bpy.app.binary_path, "Blender runs as a Python module, which has no animation player"),
        )

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the player as a process of its own."""
        frames, render = results_of(context.scene).get(self.camera), context.scene.render
        if frames is None:
            self.report({"ERROR"}, message('camera "{name}" has no images in the output folder', name=self.camera))
            return {"CANCELLED"}
        try:
            subprocess.Popen(player_command(bpy.app.binary_path, frames, render.fps, render.fps_base))
        except OSError as fault:
            self.report({"ERROR"}, str(fault))
            return {"CANCELLED"}
        return {"FINISHED"}


CLASSES = (UNISIM_OT_open_output, UNISIM_OT_play_result)
