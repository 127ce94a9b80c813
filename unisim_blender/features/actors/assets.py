"""Actors in the Asset Browser, with their own images."""

import time
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
from bpy.props import StringProperty
from numpy.typing import NDArray

from ...bridge.objects.imported import new_actor, source_of
from ...bridge.window import drive
from ...core.errors import UnisimError
from ...editing.actors.table import names_at_import
from ...editing.sampled.scene import size_text
from ...preferences import interpreter
from ...process.client import client
from ...translations import message
from ..operator_bases import InSteps, Needing
from .appearances import trained
from .thumbnails import asked_portrait

PAUSE_S = 0.002
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
        source, path = source_of(context.scene), Path(self.filepath).with_suffix(".blend")
        assert source.scene_path is not None  # the operator's needs have seen to it
        assets: list[bpy.types.Object] = []
        actors, names = sorted(source.drive.actors.items()), names_at_import(source)
        try:
            for number, (uid, actor) in enumerate(actors):
                portrait = asked_portrait(source, actor)
                if portrait is None:
                    continue
                said = message("Preview {number} of {count}", number=number + 1, count=len(actors))
                yield message("{text} (Esc to cancel)", text=said)
                while not portrait.ended:
                    portrait.take(client(interpreter()))
                    time.sleep(PAUSE_S)
                    yield None
                if portrait.rgba is None:
                    raise UnisimError(portrait.fault)
                obj = new_actor(names[uid], actor)
                assets.append(obj)
                obj.unisim.look, obj.unisim.look_scene = uid, str(source.scene_path.resolve())
                obj.asset_mark()
                obj.asset_data.tags.new(TAG)
                obj.asset_data.tags.new(actor.label)
                obj.asset_data.description = size_text(actor.size_m)
                set_preview(obj, portrait.rgba)
            path.parent.mkdir(parents=True, exist_ok=True)
            bpy.data.libraries.write(str(path), set(assets), fake_user=True, compress=True)
        except RuntimeError as fault:  # of Blender, where it cannot write
            raise UnisimError(str(fault)) from fault
        finally:
            for obj in assets:
                bpy.data.objects.remove(obj)
        done = message("Library written to {path} (actors: {count})", count=len(assets), path=path)
        self.report({"INFO"}, done)


def set_preview(obj: bpy.types.Object, rgba: NDArray[np.float32]) -> None:
    """Give an asset an image (H, W, 4) of display-referred sRGB."""
    preview = obj.preview_ensure()
    preview.image_size = rgba.shape[1], rgba.shape[0]
    preview.image_pixels_float.foreach_set(np.ascontiguousarray(rgba[::-1], np.float32).ravel())
