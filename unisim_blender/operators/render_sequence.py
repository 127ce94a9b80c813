"""All sensors over the frame range into a folder, in the background."""

from pathlib import Path

import bpy

from ..bridge.writing import write_scenario
from ..core.errors import UnisimError
from ..preferences import device, interpreter
from ..tasks import SequenceTask
from .background import launch, running
from .export_scenario import scenario_of
from .polling import allowed, drive, idle

SCENARIO = "scenario.json"


def output_folder(scene: bpy.types.Scene) -> Path:
    """Return the folder that a scene's sequences go to. Raises `UnisimError` where none is set."""
    out = scene.unisim.out
    if not out:
        raise UnisimError("no output folder is set: UniSim > Output > Folder")
    if out.startswith("//") and not bpy.data.filepath:
        raise UnisimError(f"{out}: lies beside the .blend, which was never saved; save it, or name another folder")
    return Path(bpy.path.abspath(out)).absolute()


class UNISIM_OT_render_sequence(bpy.types.Operator):
    """Render all sensors of the scene over its frame range into the output folder. Frames that are there already stay"""

    bl_idname = "unisim.render_sequence"
    bl_label = "Render Sequence"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A drive has to be there, and nothing else be running."""
        return allowed(cls, drive(context), idle(running))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write the scenario beside the frames and start the command line on it."""
        try:
            folder = output_folder(context.scene)
            folder.mkdir(parents=True, exist_ok=True)
            scenario = scenario_of(context.scene, folder / SCENARIO)
            write_scenario(scenario, folder / SCENARIO)
        except (UnisimError, OSError) as fault:
            self.report({"ERROR"}, str(fault))
            return {"CANCELLED"}
        scene = context.scene
        wanted = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
        arguments = ["render", str(folder / SCENARIO), "--out", str(folder), "--resume", "--device", device()]
        task = SequenceTask(arguments, folder, float(len(wanted)), interpreter())
        task.wanted = wanted
        launch(task)
        if bpy.app.background and task.problem:
            self.report({"ERROR"}, task.problem)
            return {"CANCELLED"}
        return {"FINISHED"}


CLASSES = (UNISIM_OT_render_sequence,)
