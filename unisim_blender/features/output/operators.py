"""All sensors over the frame range into a folder, in the background."""

from collections.abc import Generator
from pathlib import Path

import bpy

from ...bridge.objects.source import source_of
from ...bridge.sampling.output_sensors import output_sensors
from ...bridge.sampling.stated_captures import rendered_keys
from ...bridge.window.polling import allowed, drive, idle
from ...core.errors import UnisimError
from ...editing.reading.writing import write_scenario
from ...preferences import device, interpreter
from ...process.background import launch, running
from ...process.tasks import SequenceTask
from ...translations import message
from ..drive.export_operators import ReadsScenes
from ..in_steps import AtOnce, in_thread

SCENARIO = "scenario.json"
MIN_WIDTH = 8
"""The narrowest image that the command line renders, in pixels."""


def output_folder(scene: bpy.types.Scene) -> Path:
    """Return the folder that a scene's sequences go to. Raises `UnisimError` where none is set."""
    out = scene.unisim.out
    if not out:
        raise UnisimError(message("Set an output folder first: UniSim > Output > Folder"))
    if out.startswith("//") and not bpy.data.filepath:
        raise UnisimError(
            message("{folder}: save the .blend first, or choose a folder that does not depend on it", folder=out)
        )
    return Path(bpy.path.abspath(out)).absolute()


def render_arguments(scene: bpy.types.Scene, folder: Path, sensors: list[str] | None) -> list[str]:
    """Return what follows `unisim` to render the scenario that lies in ``folder`` into that folder; None
    are all sensors."""
    arguments = ["render", str(folder / SCENARIO), "--out", str(folder), "--resume", "--device", device()]
    arguments += ["--sensors", ",".join(sensors)] if sensors is not None else []
    width = scene.unisim.sequence_width
    return arguments + (["--width", str(max(MIN_WIDTH, width))] if width else [])


class UNISIM_OT_render_sequence(AtOnce, ReadsScenes, bpy.types.Operator):
    """Render the sensors over the frame range into the output folder, in the background; finished frames are kept"""

    bl_idname = "unisim.render_sequence"
    bl_label = "Render Sequence"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A drive has to be there, and nothing else be running."""
        return allowed(cls, drive(context), idle(running))

    def work(self, context: bpy.types.Context) -> Generator[str | None, None, None]:
        """Write the scenario beside the frames and start the command line on it."""
        scene = context.scene
        folder = output_folder(scene)
        sensors = output_sensors(scene, context.selected_objects, source_of(scene).drive)
        folder.mkdir(parents=True, exist_ok=True)
        scenario = yield from self.scenario(scene, folder / SCENARIO)
        yield from in_thread(lambda: write_scenario(scenario, folder / SCENARIO))
        wanted = rendered_keys(scene, scenario, source_of(scene).drive)
        task = SequenceTask(render_arguments(scene, folder, sensors), folder, float(len(wanted)), interpreter())
        task.wanted = wanted
        launch(task)
        if bpy.app.background and task.problem:
            raise UnisimError(task.problem)


CLASSES = (UNISIM_OT_render_sequence,)
