"""Render engine "UniSim": F12 and Ctrl-F12 show what the scene's camera would have recorded."""

from __future__ import annotations

import queue
import textwrap
import time
from contextlib import suppress
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..bridge.objects.imported import source_of
from ..bridge.sampling.adjacent_frames import with_lengths
from ..bridge.sampling.stepping import image_size, moment
from ..bridge.window import redraw_rendered, run_soon
from ..core.colour import linear_from_srgb
from ..core.errors import UnisimError
from ..editing.images.views import marked_outside, outside_drive
from ..editing.reading.requests import camera_request
from ..preferences import device, interpreter
from ..process.client import Client, Request, client, progress_line
from ..process.preparation import PREPARATION
from ..translations import interface, localized
from .views import VIEWS, ViewportImage

CANCEL_POLL_S = 0.05
"""Between two looks at whether the user has had enough."""
POLL_S = 0.01
"""Between two looks at whether something has come for a viewport."""
MIN_PAUSE_S, PAUSE_FACTOR = 0.1, 3.0
"""Shortest pause between two drawings of an image that arrives in parts, seconds, and as a multiple of the time that
the last drawing took: where OpenGL is software, drawing takes its time from the worker. The first and the last of an
image are drawn at once."""
REPORT_LETTERS = 90
"""Of a line of an error of F12."""
PASSES = {
    "Depth": ("use_pass_z", 1, "Z", "VALUE", "depth"),
    "Normal": ("use_pass_normal", 3, "XYZ", "VECTOR", "normal"),
    "IndexOB": ("use_pass_object_index", 1, "X", "VALUE", "instance"),
    "Opacity": (None, 1, "X", "VALUE", "opacity"),
}
"""By Blender's name: the view layer's switch (None: the scene's own), channels, their names, their
kind, core's name."""
NO_DEPTH = 1e10
"""Depth that Blender writes where there is nothing."""


def wanted_passes(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[str]:
    """Blender's names of the passes that a view layer asks for, beside Combined."""
    return [
        name
        for name, (switch, *_) in PASSES.items()
        if (getattr(layer, switch) if switch else scene.unisim.opacity_pass)
    ]


class UniSimEngine(bpy.types.RenderEngine):
    """Neural rendering in the worker; Blender's process gathers and waits."""

    bl_idname = "UNISIM"
    bl_label = "UniSim"
    bl_use_preview = False
    bl_use_shading_nodes_custom = False

    def update_render_passes(self, scene: bpy.types.Scene = None, renderlayer: bpy.types.ViewLayer = None) -> None:
        self.register_pass(scene, renderlayer, "Combined", 4, "RGBA", "COLOR")
        for name in wanted_passes(scene, renderlayer):
            _, channels, letters, kind, _ = PASSES[name]
            self.register_pass(scene, renderlayer, name, channels, letters, kind)

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        """One frame: read the scene about it, then wait for bands of the image."""
        scene = depsgraph.scene
        worker = client(interpreter())
        try:
            request, result_image = self._asked(worker, scene, depsgraph)
        except (UnisimError, OSError) as fault:
            self._fail(str(fault))
            return
        self._fill(worker, request, result_image)

    # ---- the viewport

    def view_update(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        self._view().changed()

    def view_draw(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Show what there is, and ask for what there is not."""
        view = self._view()
        view.follow(context, depsgraph)
        view.gather()
        view.draw(self, depsgraph.scene, context.region)
        self.update_stats("UniSim", view.activity if context.space_data.overlay.show_overlays else view.sentence)
        if view.expects:
            run_soon(_look, POLL_S)

    def _view(self) -> ViewportImage:
        if not hasattr(self, "view"):
            self.view = ViewportImage()
        return self.view

    def __del__(self) -> None:
        with suppress(ReferenceError):  # Blender's half is gone already
            view = getattr(self, "view", None)
            if view is not None:
                view.drop()

    # ---- an image

    def _asked(
        self, worker: Client, scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph
    ) -> tuple[Request, ResultImage]:
        self.update_stats("UniSim", interface("Reading the scene"))
        for shown in list(VIEWS):
            shown.make_way()
        PREPARATION.stopped = False  # the image needs it
        render, source = scene.render, source_of(scene)
        if scene.camera is None:
            raise UnisimError(f'scene "{scene.name}": has no camera')
        shown, part = scene.frame_current, scene.frame_subframe
        frame = shown + part
        if outside := outside_drive(frame, source.drive):
            self.report({"WARNING"}, localized(outside))

        def step(whole: int) -> None:
            self.frame_set(whole, subframe=0.0)

        sampled, view = moment(scene, depsgraph, source, frame, step, scene.camera)
        sampled = with_lengths(sampled, scene, source.drive)
        self.frame_set(shown, subframe=part)
        size = image_size(render)
        layer = depsgraph.view_layer_eval
        names = wanted_passes(scene, layer)
        result_image = ResultImage(size, border_of(render, size), names, layer.name, bool(outside))
        asked = camera_request(sampled, view, source, frame, size, render.pixel_aspect_y / render.pixel_aspect_x)
        result_image.indices = asked.indices
        height = size[1]
        left, bottom, right, top = result_image.border
        clip = scene.unisim.clip_render and not (view.kind == "CAMERA" and view.uid in source.drive.cameras)
        request = worker.ask(
            "camera",
            **asked.values,
            passes=["rgb", *(PASSES[name][-1] for name in names), *(["unsupported"] if clip else [])],
            clip=clip,
            quality=scene.unisim.quality,
            shadows=scene.unisim.contact_shadows,
            fill=scene.unisim.fill,
            detail=scene.unisim.detail,
            device=device(),
            rows=[height - top, height - bottom],
            columns=[left, right],
        )
        return request, result_image

    def _fill(self, worker: Client, request: Request, result_image: ResultImage) -> None:
        """Put bands into the result as they come; Esc ends it at once."""
        self.update_stats("UniSim", interface("Rendering"))
        left, bottom, right, top = result_image.border
        # a border's result begins at its own corner, whether the image is cropped to it or not
        result = self.begin_result(0, 0, right - left, top - bottom, layer=result_image.layer)
        cancelled = False
        try:
            while True:
                if self.test_break():
                    worker.cancel(request)
                    cancelled = True
                    return
                try:
                    event = request.events.get(timeout=CANCEL_POLL_S)
                except queue.Empty:
                    continue
                if event["event"] == "error":
                    self._fail(event["text"])
                    cancelled = True
                    return
                if event["event"] == "progress":
                    self.update_stats("UniSim", progress_line(event))
                    continue
                if event["event"] == "warning":
                    self.report({"WARNING"}, event["text"])
                    continue
                if event["event"] != "arrays":
                    return
                done = result_image.put(event, worker.arrays(event))
                passes = result.layers[0].passes
                for name, values in result_image.buffers.items():
                    render_pass = passes.find_by_name(name, "")
                    if render_pass is not None:
                        render_pass.rect.foreach_set(values.reshape(-1))
                self.update_result(result)
                self.update_progress(done)
        finally:
            self.end_result(result, cancel=cancelled)

    def _fail(self, sentence: str) -> None:
        """Say why there is no image, to the window and to scripts."""
        lines = [sentence] if bpy.app.background else textwrap.wrap(sentence, REPORT_LETTERS)
        self.error_set(sentence)
        self.report({"ERROR"}, "\n".join(lines))  # the window shows it as a menu, with a row for each


class ResultImage:
    """Received part of an image: for each pass an array, its lowest row first, of the border's size.

    ``border`` is (left, bottom, right, top) in pixels of the whole image of ``size`` (width, height), counted from
    below as Blender does. ``outside``: whether it is of a frame outside the drive: its colours are marked so.
    """

    def __init__(
        self,
        size: tuple[int, int],
        border: tuple[int, int, int, int],
        names: list[str],
        layer: str,
        outside: bool = False,
    ) -> None:
        self.size, self.border, self.layer, self.outside = size, border, layer, outside
        left, bottom, right, top = border
        shape = top - bottom, right - left
        self.buffers = {"Combined": np.zeros((*shape, 4), np.float32)}
        self.buffers |= {name: np.zeros((*shape, PASSES[name][1]), np.float32) for name in names}
        self.indices: dict[str, int] = {}

    def put(self, event: dict[str, Any], arrays: dict[str, Any]) -> float:
        """Put a band in; the share of the image that is there."""
        first, last = event["rows"]
        height = self.size[1]
        _, bottom, _, top = self.border
        rows = slice(height - last - bottom, height - first - bottom)
        self.buffers["Combined"][rows, :, :3] = linear_from_srgb(np.clip(arrays["rgb"], 0, 1))[::-1]
        self.buffers["Combined"][rows, :, 3] = 1.0
        if "unsupported" in arrays:  # asked for where it is left out
            self.buffers["Combined"][rows][arrays["unsupported"][::-1]] = 0.0
        if self.outside:
            self.buffers["Combined"][rows] = marked_outside(self.buffers["Combined"][rows], rows.start)
        for name, buffer in self.buffers.items():
            if name != "Combined":
                buffer[rows] = self._values(name, event, arrays)[::-1].reshape(last - first, *buffer.shape[1:])
        return (last - (height - top)) / (top - bottom)

    def _values(self, name: str, event: dict[str, Any], arrays: dict[str, Any]) -> NDArray[Any]:
        if name == "Depth":
            return np.where(np.isfinite(arrays["z_depth_m"]), arrays["z_depth_m"], NO_DEPTH)
        if name == "IndexOB":
            table = np.array([0, *(self.indices.get(uid, 0) for uid in event["instances"])], np.float32)
            return table[arrays["instance"]]
        return np.asarray(arrays[PASSES[name][-1]])


def border_of(render: bpy.types.RenderSettings, size: tuple[int, int]) -> tuple[int, int, int, int]:
    """The part of an image of ``size`` (width, height) that is rendered: left, bottom, right, top in pixels."""
    width, height = size
    if not render.use_border:
        return 0, 0, width, height
    left, right = int(render.border_min_x * width), int(render.border_max_x * width)
    bottom, top = int(render.border_min_y * height), int(render.border_max_y * height)
    return left, bottom, max(right, left + 1), max(top, bottom + 1)


_asked_s, _quiet_until_s = 0.0, 0.0
"""When a drawing was asked for that is not done, and until when there is to be none."""


def _look() -> float | None:
    """Draw the viewports again when there is something to draw: parts of an image are on their way."""
    global _asked_s, _quiet_until_s
    now = time.monotonic()
    if _asked_s:  # timers run when all is drawn
        _quiet_until_s, _asked_s = now + max(MIN_PAUSE_S, PAUSE_FACTOR * (now - _asked_s)), 0.0
    views = list(VIEWS)
    if any(view.news(now > _quiet_until_s) for view in views):
        _asked_s = now
        redraw_rendered()
    return POLL_S if any(view.expects for view in views) else None


def compatible_panels() -> list[Any]:
    """Blender's own panels that mean something with this engine: those that the built-in engine has, but
    its own settings."""
    left_out = {"RENDER_PT_gpencil", "RENDER_PT_simplify", "VIEWLAYER_PT_filter", "VIEWLAYER_PT_layer_passes"}
    return [
        panel
        for panel in bpy.types.Panel.__subclasses__()
        if "BLENDER_RENDER" in getattr(panel, "COMPAT_ENGINES", ()) and panel.__name__ not in left_out
    ]


def register() -> None:
    """Add the engine, and show Blender's own panels with it."""
    for panel in compatible_panels():
        panel.COMPAT_ENGINES.add(UniSimEngine.bl_idname)


def unregister() -> None:
    """Take the engine away."""
    for panel in bpy.types.Panel.__subclasses__():
        getattr(panel, "COMPAT_ENGINES", set()).discard(UniSimEngine.bl_idname)
