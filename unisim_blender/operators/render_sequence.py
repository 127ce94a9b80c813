"""All sensors over the frame range into a folder, in the background."""

from pathlib import Path

import bpy

from ..bridge.output_sensors import output_sensors
from ..bridge.source import source_of
from ..bridge.writing import write_scenario
from ..core.errors import UnisimError
from ..preferences import device, interpreter
from ..tasks import SequenceTask
from ..translations import message
from .background import launch, running
from .export_scenario import scenario_of
from .polling import allowed, drive, idle

SCENARIO = "scenario.json"
MIN_WIDTH = 8
"""The narrowest image that the command line renders, in pixels."""


class UNISIM_OT_render_sequence(bpy.types.Operator):
    """Render the sensors over the frame range into the output folder, in the background; finished frames are kept"""

    bl_idname = "unisim.render_sequence"
    bl_label = "Render Sequence"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A drive has to be there, and nothing else be running."""
        return allowed(cls, drive(context), idle(running))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write the scenario beside the frames and start the command line on it."""
        about = context.scene.unisim
        folder = Path(bpy.path.abspath(about.out)).absolute()
        try:
            if not about.out:
                raise UnisimError(message("Set an output folder first: UniSim > Output > Folder"))
            if about.out.startswith("//") and not bpy.data.filepath:
                raise UnisimError(
                    message("{folder}: save the .blend first, or choose a folder that does not depend on it", folder=about.out)
                )
            sensors = output_sensors(context.scene, context.selected_objects, source_of(context.scene).drive)
            folder.mkdir(parents=True, exist_ok=True)
            scenario = scenario_of(context.scene, folder / SCENARIO)
            write_scenario(scenario, folder / SCENARIO)
        except (UnisimError, OSError) as fault:
            self.report({"ERROR"}, str(fault))
            return {"CANCELLED"}
        scene = context.scene
        wanted = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
        arguments = ["render", str(folder / SCENARIO), "--out", str(folder), "--resume", "--device", device()]
        arguments += ["--sensors", ",".join(sensors)] if sensors is not None else []
        arguments += ["--width", str(max(MIN_WIDTH, about.sequence_width))] if about.sequence_width else []
        task = SequenceTask(arguments, folder, float(len(wanted)), interpreter())
        task.wanted = wanted
        launch(task)
        if bpy.app.background and task.problem:
            self.report({"ERROR"}, task.problem)
            return {"CANCELLED"}
        return {"FINISHED"}


CLASSES = (UNISIM_OT_render_sequence,)
