"""All sensors over the frame range into a folder, in the background; and what a sequence left there."""

import subprocess
from collections.abc import Generator
from pathlib import Path
from typing import Any

import bpy
from bpy.props import EnumProperty

from ...bridge.objects.imported import source_of
from ...bridge.objects.settings import output_sensors, rendered_keys
from ...bridge.window import Need, drive, folder_on_disk
from ...core.errors import UnisimError
from ...editing.images.rendered import RenderedFrames, player_command, rendered_cameras
from ...editing.reading.scenario import write_scenario
from ...editing.texts import translatable
from ...preferences import device, interpreter
from ...process.background import launch
from ...process.tasks import SequenceTask, Task
from ...translations import message
from ..drive.export_operators import scenario_steps
from ..operator_bases import AtOnce, Needing, in_thread, nothing_runs, reporting

SCENARIO = "scenario.json"
MIN_WIDTH = 8
"""The narrowest image that the command line renders, in pixels."""
FILMS = ("film.mp4", "film.html")
"""Names of films in the folder of a sequence, as `unisim film` has them."""
_shown: list[tuple[str, str, str]] = []
"""The newest menu's items: Blender does not store them."""


def output_folder(scene: bpy.types.Scene) -> Path:
    """Return the folder that a scene's sequences go to. Raises `UnisimError` where none is set."""
    out = scene.unisim.out
    if not out:
        raise UnisimError(message("Set an output folder first: UniSim > Output > Folder"))
    folder = folder_on_disk(out)
    if folder is None:
        raise UnisimError(
            message("{folder}: save the .blend first, or choose a folder that does not depend on it", folder=out)
        )
    return folder


def render_arguments(scene: bpy.types.Scene, folder: Path, sensors: list[str] | None) -> list[str]:
    """Return what follows `unisim` to render the scenario that lies in ``folder`` into that folder; None
    are all sensors."""
    arguments = ["render", str(folder / SCENARIO), "--out", str(folder), "--resume", "--device", device()]
    return [*arguments, *sensor_options(sensors), *width_options(scene)]


def sensor_options(sensors: list[str] | None) -> list[str]:
    """Return the command line's options for sensors; None are all."""
    return [] if sensors is None else ["--sensors", ",".join(sensors)]


def width_options(scene: bpy.types.Scene) -> list[str]:
    """Return the command line's options for the width of a scene's sequences."""
    width = scene.unisim.sequence_width
    return ["--width", str(max(MIN_WIDTH, width))] if width else []


class UNISIM_OT_render_sequence(Needing, AtOnce, bpy.types.Operator):
    """Render the sensors over the frame range into the output folder, in the background; finished frames are kept"""

    bl_label = "Render Sequence"
    bl_options = {"REGISTER"}
    needs = (drive, nothing_runs)

    def work(self, context: bpy.types.Context) -> Generator[str | None, None, None]:
        scene = context.scene
        folder = output_folder(scene)
        sensors = output_sensors(scene, context.selected_objects, source_of(scene).drive)
        folder.mkdir(parents=True, exist_ok=True)
        scenario = yield from scenario_steps(scene, folder / SCENARIO)
        yield from in_thread(lambda: write_scenario(scenario, folder / SCENARIO))
        wanted = rendered_keys(scene, scenario, source_of(scene).drive)
        task = SequenceTask(render_arguments(scene, folder, sensors), folder, float(len(wanted)), interpreter())
        task.wanted = wanted
        launch(task)


def known_folder(scene: bpy.types.Scene) -> Path | None:
    """Return the folder that a scene's sequences go to; None while it is not known."""
    return folder_on_disk(scene.unisim.out)


def results_of(scene: bpy.types.Scene) -> dict[str, RenderedFrames]:
    """Return the finished images of the scene's output folder by camera."""
    folder = known_folder(scene)
    return {} if folder is None else rendered_cameras(folder)


def camera_items(self: bpy.types.Operator, context: bpy.types.Context) -> list[tuple[str, str, str]]:
    """The cameras that have images, for a menu."""
    results = results_of(context.scene)
    _shown[:] = [(name, name, message("Images: {count}", count=frames.count)) for name, frames in results.items()]
    return _shown or [("", "None", "")]


def folder_known(context: bpy.types.Context) -> Need:
    """The output folder is known."""
    return known_folder(
        context.scene
    ) is not None, "Save the .blend first, or choose a folder that does not depend on it"


class UNISIM_OT_open_output(Needing, bpy.types.Operator):
    """Open the output folder in the system's file browser"""

    bl_label = "Open Folder"
    bl_options = {"REGISTER"}
    needs = (
        drive,
        folder_known,
        lambda context: (
            (folder := known_folder(context.scene)) and folder.is_dir(),
            "The output folder does not exist yet: render first",
        ),
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        return bpy.ops.wm.path_open(filepath=str(known_folder(context.scene)))


class UNISIM_OT_play_result(Needing, bpy.types.Operator):
    """Play the rendered images of a camera in Blender's animation player"""

    bl_label = "Play Result"
    bl_options = {"REGISTER"}

    camera: EnumProperty(name="Camera", description="Camera whose images are played", items=camera_items)
    needs = (
        drive,
        folder_known,
        lambda context: (
            results_of(context.scene),
            "The output folder has no camera images yet: render a sequence first",
        ),
        lambda context: (bpy.app.binary_path, "Blender runs as a Python module, which has no animation player"),
    )

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        frames, render = results_of(context.scene).get(self.camera), context.scene.render
        if frames is None:
            raise UnisimError(message('camera "{name}" has no images in the output folder', name=self.camera))
        subprocess.Popen(player_command(bpy.app.binary_path, frames, render.fps, render.fps_base))
        return {"FINISHED"}


class FilmTask(Task):
    """A film of a finished sequence. The command line tells of each frame."""

    title = translatable("Film")
    hears = True
    done = 0.0

    def hear(self, event: dict[str, Any]) -> None:
        """Take how many of how many frames are done."""
        self.done, self.total = event.get("done", self.done), event.get("total", self.total)


def sequence_finished(context: bpy.types.Context) -> Need:
    """The output folder holds a finished sequence."""
    folder = known_folder(context.scene)
    finished = folder is not None and (folder / "manifest.json").is_file()
    return finished, "The output folder has no finished sequence yet: render one first"


class UNISIM_OT_make_film(Needing, bpy.types.Operator):
    """Write a film of the finished sequence, in the background: Sensors of it side by side, LiDARs from above"""

    bl_label = "Make Film"
    bl_options = {"REGISTER"}
    needs = (drive, folder_known, sequence_finished, nothing_runs)

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        scene = context.scene
        folder, sensors = output_folder(scene), output_sensors(scene, context.selected_objects, source_of(scene).drive)
        task = FilmTask(["film", str(folder), "--json", *sensor_options(sensors)], folder, 0.0, interpreter())
        launch(task)
        return {"FINISHED"}


def film_of(scene: bpy.types.Scene) -> Path | None:
    """Return the newest film in the output folder; None where there is none."""
    folder = known_folder(scene)
    films = [path for name in FILMS if folder is not None and (path := folder / name).is_file()]
    return max(films, key=lambda path: path.stat().st_mtime_ns, default=None)


class UNISIM_OT_open_film(Needing, bpy.types.Operator):
    """Open the film of the sequence: MP4, or where the renderer's Python lacks imageio-ffmpeg a page for the browser"""

    bl_label = "Open Film"
    bl_options = {"REGISTER"}
    needs = (drive, lambda context: (film_of(context.scene), "There is no film yet: make one first"))

    def execute(self, context: bpy.types.Context) -> set[str]:
        return bpy.ops.wm.path_open(filepath=str(film_of(context.scene)))
