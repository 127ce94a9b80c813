"""Tasks in the background: watched, shown, cancelled."""

import time
import traceback
from pathlib import Path

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..bridge.window import allowed, redraw, redraw_status_bar
from ..core.errors import UnisimError
from ..editing.layout.chart import ChartImage, training_chart
from ..editing.texts import Text
from ..translations import message
from .tasks import SequenceTask, Task, TrainingTask

POLL_S = 0.5
REPORT_S = 5.0
"""Interval of reports of the remaining time: Blender redraws the whole window for each, which renderers wait for."""
PREVIEW, CURVE = "UniSim preview", "UniSim training"
"""Images that show what runs."""

running: list[Task] = []
"""The task at hand, and nothing else."""
newest: dict[type[Task], Task] = {}
"""The task of each kind that was begun last."""
openings: list[int] = [0]
"""How many files this Blender has opened."""
reported: list[tuple[float, bool]] = []
"""Progress of the task at hand, and whether it was cancelled, at the last report."""
reported_at: list[float] = []
"""Time of the last report."""
previewed: list[tuple[Path, int]] = []
"""The image file that is shown, and its time of change."""


def watch() -> float | None:
    """Tell the window how far the task is; as a timer of Blender's, until it ends."""
    if not running:
        return None
    task = running[0]
    ended = not task.running  # asked first: what is reported of a task that has ended is reported of its end
    news = ended or _is_news(task)
    try:
        if news:
            tell(task)
    except Exception:  # Blender drops a timer that fails, and nothing could be started ever after
        traceback.print_exc()
    if ended:
        running.clear()
        task.finish()
    if news and not bpy.app.background:
        redraw_status_bar()
    return None if ended else POLL_S


def _is_news(task: Task) -> bool:
    """Return whether more is done than was reported, or that was long ago."""
    state, now = (task.done, task.cancelled), time.monotonic()
    if reported == [state] and now - reported_at[0] < REPORT_S:
        return False
    reported[:], reported_at[:] = [state], [now]
    return True


def tell(task: Task) -> None:
    """Show in the window how far a task is."""
    task.line, task.fraction_shown = task.text(), task.fraction
    redraw("VIEW_3D", "IMAGE_EDITOR")
    if not of_file(task):  # its images are none of the file that is open
        return
    image_path = task.newest() if isinstance(task, SequenceTask) else task.folder / "preview.png"
    if image_path is not None and image_path.is_file():
        show(image_path)
    if isinstance(task, TrainingTask):
        show_curve(training_chart(task.curve(), task.total))


def of_file(task: Task) -> bool:
    """Return whether a task belongs to the file that is open."""
    return task.opening == openings[0] or bool(task.file and task.file == bpy.data.filepath)


def is_own(task: Task, scene: bpy.types.Scene) -> bool:
    """Return whether a task belongs to a scene of the file that is open."""
    if not task.of_scene or not of_file(task):
        return of_file(task)
    return scene.session_uid == task.scene_uid if task.opening == openings[0] else scene.name == task.scene


def owner(task: Task) -> str:
    """Return the name of the file that a task belongs to; of the open file, that of the scene."""
    if of_file(task) and task.of_scene:
        return task.scene
    return Path(task.file).name if task.file else message("unsaved file")


def what_runs() -> Text | None:
    """Return the name of the task at hand and whose it is; None without one."""
    return Text("{task} runs for {owner}", task=Text(running[0].title), owner=owner(running[0])) if running else None


@persistent
def note_opened(*_: object) -> None:
    """Another file is open: tasks belong to the one before, and its lines go."""
    openings[0] += 1
    bpy.context.window_manager.unisim_points = ""


@persistent
def note_saved(*_: object) -> None:
    """Let the tasks of the open file belong to it under the name that it was saved as."""
    for task in newest.values():
        if task.opening == openings[0]:
            task.file = bpy.data.filepath


def show(image_path: Path) -> None:
    """Put an image file into the image that previews are shown in."""
    image = bpy.data.images.get(PREVIEW)
    try:
        state = image_path, image_path.stat().st_mtime_ns
        if image is not None and previewed == [state]:
            return
        previewed[:] = [state]
        if image is None:
            image = bpy.data.images.load(str(image_path))
            image.name = PREVIEW
        elif bpy.path.abspath(image.filepath) != str(image_path):
            image.filepath = str(image_path)
        image.reload()
    except (RuntimeError, OSError):  # it is being written: the next look finds it
        previewed.clear()


def show_curve(chart: ChartImage) -> None:
    """Put a chart (H, W, 3) into the image that curves are shown in, and into its icon for the panel."""
    height, width = chart.shape[:2]
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = chart[::-1]
    image = bpy.data.images.get(CURVE) or bpy.data.images.new(CURVE, width, height)
    image.pixels.foreach_set(pixels.ravel())
    image.pack()  # else Blender asks at its end whether to save it
    icon = image.preview_ensure()
    icon.image_size = width, height
    icon.image_pixels_float.foreach_set(pixels.ravel())


def curve_icon() -> int | None:
    """The icon of the newest training's curve; None where this file has none."""
    task = newest.get(TrainingTask)
    image = bpy.data.images.get(CURVE) if task is not None and of_file(task) else None
    return image.preview.icon_id if image is not None and image.preview is not None else None


def launch(task: Task) -> None:
    """Begin a task and watch it; without a window, wait for its end, and raise `UnisimError` where it failed."""
    scene = bpy.context.scene
    task.file, task.opening, task.scene, task.scene_uid = bpy.data.filepath, openings[0], scene.name, scene.session_uid
    running[:], newest[type(task)] = [task], task
    reported.clear()
    task.start()
    if bpy.app.background:
        while task.running:
            time.sleep(POLL_S / 5)
        watch()
        if task.problem:
            raise UnisimError(task.problem)
    else:
        # another file may be opened while it runs
        bpy.app.timers.register(watch, first_interval=POLL_S, persistent=True)


class UNISIM_OT_cancel_task(bpy.types.Operator):
    """Stop the background task; finished frames are kept, and starting it again resumes"""

    bl_label = "Cancel"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return allowed(cls, (running, "No task is running"))

    def execute(self, context: bpy.types.Context) -> set[str]:
        for task in running:
            task.cancel()
        return {"FINISHED"}


HANDLERS = (("load_post", note_opened), ("save_post", note_saved))
TIMERS = (watch,)


def unregister() -> None:
    """End what runs."""
    for task in running:
        task.cancel()
    running.clear()
    newest.clear()
