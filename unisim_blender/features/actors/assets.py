"""Actors in the Asset Browser, with their own images."""

import queue
from collections.abc import Generator
from pathlib import Path

import bpy
import numpy as np
from bpy.props import StringProperty
from numpy.typing import NDArray

from ...bridge.objects.imported import new_actor, source_of
from ...bridge.window import allowed, drive
from ...core.errors import UnisimError
from ...editing.actors.portraits import portrait_request
from ...editing.actors.table import names_at_import
from ...editing.sampled.scene import size_text
from ...editing.sampled.source import DriveSource
from ...preferences import device, interpreter
from ...process.client import client
from ...translations import message
from ..operator_bases import reporting

POLL_S = 0.1
TAG = "UniSim"


class UNISIM_OT_make_library(bpy.types.Operator):
    """Write the actors of the trained scene to a .blend file of assets"""

    bl_label = "Make Actor Library"
    bl_options = {"REGISTER"}

    filepath: StringProperty(
        subtype="FILE_PATH",
        description="Path of the .blend file, in a folder listed in Preferences > File Paths > Asset Libraries",
    )
    filter_glob: StringProperty(default="*.blend", options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A trained scene has to be there."""
        return allowed(cls, drive(context), (context.scene.unisim.scene, "Import or train a trained scene first"))

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the file."""
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Portraits come from the worker one after the other."""
        source = source_of(context.scene)
        path = Path(self.filepath).with_suffix(".blend")
        self.steps = make_library(source, path)
        if bpy.app.background:
            return self.finish(list(self.steps)[-1])
        self.timer = context.window_manager.event_timer_add(POLL_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """A look at each tick whether the next portrait has come."""
        if event.type == "ESC":
            self.steps.close()
            return self.end(context, {"CANCELLED"})
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            self.said = next(self.steps)
            context.workspace.status_text_set(message("{text} (Esc to cancel)", text=self.said))
        except StopIteration:
            return self.end(context, self.finish(self.said))
        return {"PASS_THROUGH"}

    def end(self, context: bpy.types.Context, result: set[str]) -> set[str]:
        """Take the timer away."""
        context.window_manager.event_timer_remove(self.timer)
        context.workspace.status_text_set(None)
        return result

    def finish(self, said: str) -> set[str]:
        """Report what came of it."""
        failed = said.startswith("Error: ")
        self.report({"ERROR" if failed else "INFO"}, said.removeprefix("Error: "))
        return {"CANCELLED"} if failed else {"FINISHED"}


def make_library(source: DriveSource, path: Path) -> Generator[str, None, None]:
    """Write the library; what is yielded says how far it is, at last what came of it."""
    assert source.scene_path is not None  # the operator has seen to it
    assets: list[bpy.types.Object] = []
    try:
        actors, names = sorted(source.drive.actors.items()), names_at_import(source)
        for number, (uid, actor) in enumerate(actors):
            asked = portrait_request(source, actor, path.stem)
            if asked is None:
                continue
            worker = client(interpreter())
            request = worker.ask(
                "camera", **asked.values, passes=["rgb", "instance"], quality="balanced", device=device()
            )
            rgb, shown = [], []
            while True:
                yield message("Preview {number} of {count}", number=number + 1, count=len(actors))
                try:
                    event = request.events.get(timeout=POLL_S) if bpy.app.background else request.events.get_nowait()
                except queue.Empty:
                    continue
                if event["event"] == "error":
                    yield f"Error: {event['text']}"
                    return
                if event["event"] == "warning":
                    continue
                if event["event"] != "arrays":
                    break
                arrays = worker.arrays(event)
                rgb.append(np.clip(arrays["rgb"], 0, 1))
                shown.append(arrays["instance"] == event["instances"].index(uid) + 1)
            obj = new_actor(names[uid], actor)
            obj.unisim.look, obj.unisim.look_scene = uid, str(source.scene_path.resolve())
            obj.asset_mark()
            obj.asset_data.tags.new(TAG)
            obj.asset_data.tags.new(actor.label)
            obj.asset_data.description = size_text(actor.size_m)
            set_preview(obj, np.concatenate(rgb), np.concatenate(shown))
            assets.append(obj)
        path.parent.mkdir(parents=True, exist_ok=True)
        bpy.data.libraries.write(str(path), set(assets), fake_user=True, compress=True)
        yield message("Library written to {path} (actors: {count})", count=len(assets), path=path)
    except (UnisimError, OSError, RuntimeError) as fault:
        yield f"Error: {fault}"
    finally:
        for obj in assets:
            bpy.data.objects.remove(obj)


def set_preview(obj: bpy.types.Object, rgb: NDArray[np.float32], shown: NDArray[np.bool_]) -> None:
    """Give an asset an image (H, W, 3) of display-referred sRGB, see-through where ``shown`` (H, W) is False."""
    rgba = np.concatenate([rgb, shown[..., None].astype(np.float32)], -1)[::-1]
    preview = obj.preview_ensure()
    preview.image_size = rgba.shape[1], rgba.shape[0]
    preview.image_pixels_float.foreach_set(np.ascontiguousarray(rgba, np.float32).ravel())
