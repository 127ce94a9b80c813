"""Actors in the Asset Browser, with their own images."""

import queue
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.props import StringProperty
from numpy.typing import NDArray

from ...bridge.objects.imported import new_actor, source_of
from ...bridge.window import drive
from ...core.errors import UnisimError
from ...editing.actors.portraits import portrait_request
from ...editing.actors.table import names_at_import
from ...editing.sampled.scene import size_text
from ...preferences import device, interpreter
from ...process.client import client
from ...translations import message
from ..operator_bases import InSteps, Needing
from .appearances import trained

POLL_S = 0.1
TAG = "UniSim"


class UNISIM_OT_make_library(InSteps, Needing, bpy.types.Operator):
    """Write the actors of the trained scene to a .blend file of assets"""

    bl_label = "Make Actor Library"
    bl_options = {"REGISTER"}
    needs = (drive, trained)
    blocks = False

    filepath: StringProperty(
        subtype="FILE_PATH",
        description="Path of the .blend file, in a folder listed in Preferences > File Paths > Asset Libraries",
    )
    filter_glob: StringProperty(default="*.blend", options={"HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.ask_for_path(context)

    def work(self, context: bpy.types.Context) -> Iterator[str | None]:
        """Write the library; portraits come from the worker one after the other."""
        source, path = source_of(context.scene), Path(self.filepath).with_suffix(".blend")
        assert source.scene_path is not None  # the operator's needs have seen to it
        assets: list[bpy.types.Object] = []
        actors, names = sorted(source.drive.actors.items()), names_at_import(source)
        try:
            for number, (uid, actor) in enumerate(actors):
                asked = portrait_request(source, actor, path.stem)
                if asked is None:
                    continue
                said = message("Preview {number} of {count}", number=number + 1, count=len(actors))
                yield message("{text} (Esc to cancel)", text=said)
                rgb, shown = yield from rendered_portrait(asked.values, uid)
                obj = new_actor(names[uid], actor)
                assets.append(obj)
                obj.unisim.look, obj.unisim.look_scene = uid, str(source.scene_path.resolve())
                obj.asset_mark()
                obj.asset_data.tags.new(TAG)
                obj.asset_data.tags.new(actor.label)
                obj.asset_data.description = size_text(actor.size_m)
                set_preview(obj, rgb, shown)
            path.parent.mkdir(parents=True, exist_ok=True)
            bpy.data.libraries.write(str(path), set(assets), fake_user=True, compress=True)
        except RuntimeError as fault:  # of Blender, where it cannot write
            raise UnisimError(str(fault)) from fault
        finally:
            for obj in assets:
                bpy.data.objects.remove(obj)
        done = message("Library written to {path} (actors: {count})", count=len(assets), path=path)
        self.report({"INFO"}, done)


def rendered_portrait(
    values: dict[str, Any], uid: str
) -> Generator[None, None, tuple[NDArray[np.float32], NDArray[np.bool_]]]:
    """Return an image (H, W, 3) of an actor that the worker renders, and where it shows the actor (H, W), waiting in
    steps. Raises `UnisimError`."""
    worker = client(interpreter())
    request = worker.ask("camera", **values, passes=["rgb", "instance"], quality="balanced", device=device())
    rgb, shown = [], []
    while True:
        try:
            event = request.events.get(timeout=POLL_S) if bpy.app.background else request.events.get_nowait()
        except queue.Empty:
            yield None
            continue
        if event["event"] == "error":
            raise UnisimError(event["text"])
        if event["event"] == "arrays":
            arrays = worker.arrays(event)
            rgb.append(np.clip(arrays["rgb"], 0, 1))
            shown.append(arrays["instance"] == event["instances"].index(uid) + 1)
        elif event["event"] != "warning":
            return np.concatenate(rgb), np.concatenate(shown)


def set_preview(obj: bpy.types.Object, rgb: NDArray[np.float32], shown: NDArray[np.bool_]) -> None:
    """Give an asset an image (H, W, 3) of display-referred sRGB, see-through where ``shown`` (H, W) is False."""
    rgba = np.concatenate([rgb, shown[..., None].astype(np.float32)], -1)[::-1]
    preview = obj.preview_ensure()
    preview.image_size = rgba.shape[1], rgba.shape[0]
    preview.image_pixels_float.foreach_set(np.ascontiguousarray(rgba, np.float32).ravel())
