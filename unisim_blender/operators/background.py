"""What runs in the background: watched, shown, cancelled."""

import time
from pathlib import Path

import bpy

from ..bridge.windows import areas
from ..registering import add, take_away
from ..tasks import SequenceTask, Task

POLL_S = 0.5
PREVIEW = "UniSim preview"

running: list[Task] = []
"""The task at hand, and nothing else."""


def watch() -> float | None:
    """Tell the window how far the task is; as a timer of Blender's, until it ends."""
    if not running:
        return None
    task = running[0]
    manager = bpy.context.window_manager
    manager.unisim_task, manager.unisim_progress = task.text(), min(1.0, task.done / max(task.total, 1e-9))
    picture = task.newest() if isinstance(task, SequenceTask) else task.folder / "preview.png"
    if picture is not None and picture.is_file():
        show(picture)
    for area in areas("VIEW_3D", "IMAGE_EDITOR"):
        area.tag_redraw()
    if task.running:
        return POLL_S
    running.clear()
    return None


def show(picture: Path) -> None:
    """Put a picture file into the image that previews are shown in."""
    image = bpy.data.images.get(PREVIEW)
    try:
        if image is None:
            image = bpy.data.images.load(str(picture))
            image.name = PREVIEW
        elif bpy.path.abspath(image.filepath) != str(picture):
            image.filepath = str(picture)
        image.reload()
    except RuntimeError:  # it is being written: the next look finds it
        pass


def launch(task: Task) -> None:
    """Begin a task and watch it; without a window, wait for its end."""
    running[:] = [task]
    task.start()
    if bpy.app.background:
        while task.running:
            time.sleep(POLL_S / 5)
        watch()
    else:
        bpy.app.timers.register(watch, first_interval=POLL_S)


class UNISIM_OT_cancel_task(bpy.types.Operator):
    """Stop what runs in the background; what is finished stays, and starting it again goes on from there"""

    bl_idname = "unisim.cancel_task"
    bl_label = "Cancel"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Something has to be running."""
        return bool(running)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ask it to end."""
        for task in running:
            task.cancel()
        return {"FINISHED"}


CLASSES = (UNISIM_OT_cancel_task,)


def register() -> None:
    """Add the operator."""
    add(CLASSES)


def unregister() -> None:
    """Take it away, and end what runs."""
    for task in running:
        task.cancel()
    running.clear()
    if bpy.app.timers.is_registered(watch):
        bpy.app.timers.unregister(watch)
    take_away(CLASSES)
