"""Rendered shading: the neural scene from any angle, coarse first, then band by band."""

from __future__ import annotations

import queue
import time
from dataclasses import dataclass, field
from functools import partial
from typing import Any
from weakref import WeakSet

import bpy
import gpu
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Matrix
from numpy.typing import NDArray

from ..bridge.objects.imported import source_of
from ..bridge.objects.weather import weather_and_sun
from ..bridge.sampling.adjacent_frames import lacking, sample_now, step_soon, with_lengths
from ..bridge.sampling.stepping import frame_of
from ..core.errors import UnisimError
from ..core.scenario import scenario_to_json
from ..core.world.drive import CameraModel
from ..editing.images.views import ViewPart, outside_drive, view_part
from ..editing.reading.requests import camera_request, without_unreadable
from ..editing.sampled.clock import Clock
from ..editing.sampled.scene import SampledObject
from ..preferences import device, interpreter
from ..process.client import Client, Request, client, progress_line
from ..process.preparation import PREPARATION
from ..translations import interface, localized
from .comparison import ViewComparison
from .options import options_of

COARSE_STRIDES = (8, 4)
"""The view is shown with one in so many pixels each way before it is finished."""
GATHER_S = 0.05
"""Time limit for taking in arrived parts in one drawing."""

VIEWS: WeakSet[ViewportImage] = WeakSet()
"""The images of all viewports, as long as they are shown."""


@dataclass(eq=False)
class ViewportImage:
    """One viewport's image and the request that fills it. ``rectangle`` is left, bottom, width,
    height in the region."""

    key: object = None
    wanted: dict[str, Any] | None = None
    job: int | None = None
    """Number of the request of whose image the pixels are that are there, but for ``unfinished``; None: of none."""
    unfinished: list[tuple[int, int, int, int]] = field(default_factory=list)
    """Left, top, right, bottom in pixels of the regions of that image that have not come, in the order in which they will."""
    request: Request | None = None
    worker: Client | None = None
    rectangle: tuple[int, int, int, int] = (0, 0, 0, 0)
    linear: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0, 4), np.float32))
    problem: str = ""
    remedy: str = ""
    """What mends the problem, as `UnisimError` names it."""
    progress: str = ""
    """Progress of what has to be computed before there is an image."""
    left_out: tuple[str, ...] = ()
    """Sentences on actors that cannot be read."""
    warning: str = ""
    """Warning of what the scene's method cannot show."""
    outside: str = ""
    """Said where the frame lies outside the drive."""
    shows_outside: bool = False
    """Whether the image that is there is of a frame outside the drive."""
    changes: int = 0
    waits: bool = False
    """Whether a render job goes first."""
    fresh: bool = False
    """Whether nothing was drawn yet of what was asked for last."""
    preliminary: bool = False
    """Whether the image that is there is of preliminary surfels, or a part of it."""
    of_preliminary: bool = False
    """Whether what comes is."""
    prepared: int = 0
    """Number of finished preparations when it was asked for."""
    log: str = ""
    """The log of a drive without a trained scene, whose surfels have to be prepared."""
    waits_for_surfels: bool = False
    """Whether these are prepared before anything can be drawn."""
    srgb: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0, 3), np.uint8))
    """The image in eight bits."""
    unsupported: NDArray[np.bool_] | None = None
    """Unsupported pixels of the image, where that was asked for; lowest row first, as the image."""
    confidence: NDArray[np.float32] | None = None
    """Confidence of its pixels likewise, 1 where it has not come yet."""
    revision: int = 0
    """Another one whenever the image is."""
    comparison: ViewComparison = field(default_factory=ViewComparison)
    region: int = 0
    """The address of the region that it is drawn into."""

    def __post_init__(self) -> None:
        VIEWS.add(self)

    @property
    def pending(self) -> bool:
        """Whether more of the image is to come."""
        return self.request is not None

    @property
    def expects(self) -> bool:
        """Whether something is to come that is not drawn yet."""
        return self.pending or self.waits or self.comparison.waits

    def news(self, late: bool) -> bool:
        """Whether there is something to draw; ``late``: whether the last drawing is long ago."""
        if self.comparison.arrived:
            return True
        if self.waits or self.request is None or self.request.events.empty():
            return self.waits and late
        return late or self.fresh or self.request.ended

    def changed(self) -> None:
        """The scene is another one now."""
        self.changes += 1

    def make_way(self) -> None:
        """Leave the worker to a render job; an image that is not finished is asked for again after it."""
        if self.pending:
            self.drop()
            self.key = self.wanted = None

    def drop(self) -> None:
        """Take back what was asked for."""
        if self.request is not None and self.worker is not None:
            self.worker.cancel(self.request)
        self.request, self.progress, self.warning = None, "", ""
        self._wait_for_surfels(None)

    @property
    def stopped(self) -> bool:
        """Whether nothing is rendered, because the user stopped the preparation."""
        return bool(self.log) and PREPARATION.is_stopped(self.log)

    def _wait_for_surfels(self, share: float | None) -> None:
        """Take the share done of a first image's surfels; None where they are not waited for."""
        if self.waits_for_surfels or share is not None:
            PREPARATION.follow(self.log, share)
        self.waits_for_surfels = share is not None

    def follow(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Ask for the image of what is looked at now, unless it was asked for already, or a render job runs."""
        self.waits = bpy.app.is_job_running("RENDER")
        if self.waits:
            return
        scene, region, space = depsgraph.scene, context.region, context.region_data
        options, self.region = options_of(context.space_data), region.as_pointer()
        self.comparison.gather()
        looks = tuple(tuple(row) for row in space.perspective_matrix)
        key = (
            looks,
            region.width,
            region.height,
            frame_of(scene),
            self.changes,
            scene.unisim.quality,
            scene.unisim.contact_shadows,
            scene.unisim.fill,
            scene.unisim.detail,
            weather_and_sun(scene),
            tuple(lamp.state for lamp in scene.unisim_lamps),
            options.mode,
            options.unsupported,
            options.confidence,
            options.clip,
            self.comparison.lacks,
            PREPARATION.finished,
            self.stopped,
        )
        if key == self.key:
            return
        self.key = key
        try:
            values = self._wanted(context, depsgraph)
            if values is None:
                self.key = None  # once that is known, the view is drawn again
                return
            if self.stopped or not self.comparison.needs_render:
                self.drop()
                self.wanted, self.problem, self.preliminary, self.fresh = None, "", False, True
                self.linear = np.zeros((0, 0, 4), np.float32)  # it may be another frame's by the time it is wanted
                return
            values = self._with_passes(values)
            # much that Blender calls a change, a selection say, shows nowhere
            refined = self.preliminary and self.prepared != PREPARATION.finished
            if values != self.wanted or self.problem or refined:
                self.gather()
                self._ask(values)
            self.problem = ""
        except (UnisimError, OSError) as fault:
            self.drop()
            self.wanted, self.problem, self.remedy = None, str(fault), getattr(fault, "remedy", "")

    def _wanted(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> dict[str, Any] | None:
        """The request for the image of what is looked at now; None where something moves in a way that is not known yet."""
        scene, space = depsgraph.scene, context.region_data
        source = source_of(scene)
        if not space.is_perspective:
            self.comparison.lacks = ""
            raise UnisimError(
                "the neural scene cannot be rendered in an orthographic view: press Numpad 5 or look through a camera"
            )
        frame = frame_of(scene)
        through = scene.camera if space.view_perspective == "CAMERA" else None
        self.outside = outside_drive(frame, source.drive)
        clock = Clock.of(source.drive).around(frame)
        also = (through,) if through is not None else ()
        if lacking(scene, clock, also):
            step_soon(scene, clock, also)
            return None
        sampled = with_lengths(sample_now(scene, depsgraph, clock, also), scene, source.drive)
        if through is not None:
            view = next(obj for obj in sampled.objects if obj.name == through.name)
            self.rectangle = camera_rectangle(context, scene)
        else:
            self.rectangle = 0, 0, context.region.width, context.region.height
            view = onlooker(context, len(clock.frames))
        aspect = scene.render.pixel_aspect_y / scene.render.pixel_aspect_x
        size = self.rectangle[2:]
        asked, self.left_out = without_unreadable(
            lambda readable: camera_request(readable, view, source, frame, size, aspect), sampled, source.drive
        )
        self.log = asked.values["log"] if asked.values["scene"] is None else ""
        options = options_of(context.space_data)
        self.comparison.follow(
            options, source, view, scenario_to_json(asked.scenario), asked.model, frame, self.log != ""
        )
        clip = options.clip and through is None
        passes = ["rgb", "unsupported"] if clip or options.unsupported else ["rgb"]
        passes += ["confidence"] if options.confidence else []
        set_up = {"quality": scene.unisim.quality, "shadows": scene.unisim.contact_shadows, "device": device()}
        set_up |= {"fill": scene.unisim.fill, "detail": scene.unisim.detail}
        return {**asked.values, **set_up, "clip": clip, "passes": passes}

    def _with_passes(self, values: dict[str, Any]) -> dict[str, Any]:
        """The same request with the pass that the finished image has already, where nothing else is to be rendered."""
        if self.wanted is None or self.pending or set(values["passes"]) >= set(self.wanted["passes"]):
            return values
        reused = {**values, "passes": self.wanted["passes"]}
        return reused if reused == self.wanted else values

    def _ask(self, values: dict[str, Any]) -> None:
        self.drop()
        width, height = self.rectangle[2:]
        worker = client(interpreter())
        if self.worker is not worker:
            self.job = None
        # a preliminary image that is there is better than a coarse one
        coarse = () if self.preliminary and not self.fresh and values == self.wanted else COARSE_STRIDES
        self.wanted, self.worker, self.prepared = values, worker, PREPARATION.finished
        if self.linear.shape[:2] != (height, width):
            self.linear = np.zeros((height, width, 4), np.float32)
            self.srgb = np.zeros((height, width, 3), np.uint8)
            self.job, self.unsupported, self.confidence, self.revision = None, None, None, self.revision + 1
        if "unsupported" not in values["passes"]:
            self.unsupported = None
        elif self.unsupported is None:
            self.job, self.unsupported = None, np.zeros((height, width), bool)
        if "confidence" not in values["passes"]:
            self.confidence = None
        elif self.confidence is None:
            self.job, self.confidence = None, np.ones((height, width), np.float32)
        self.request = worker.ask(
            "camera",
            prepare=partial(view_part, size=(height, width), clip=values["clip"]),
            **values,
            coarse=coarse,
            preliminary=True,
            update={"job": self.job, "unfinished": self.unfinished},
        )
        self.fresh = True

    def gather(self) -> None:
        """Take in what has come of the image; where that is much, the rest with the next drawing."""
        until = time.perf_counter() + GATHER_S
        while self.request is not None and self.worker is not None and time.perf_counter() < until:
            try:
                event = self.request.events.get_nowait()
            except queue.Empty:
                return
            if event["event"] == "progress":
                if event.get("pauses"):
                    self._wait_for_surfels(event["share"])
                else:
                    self.progress = progress_line(event)
                continue
            if event["event"] == "warning":
                self.warning = event["text"]
                continue
            self.progress = ""
            self._wait_for_surfels(None)
            if event["event"] == "regions":
                self.of_preliminary = event["preliminary"]
                self.preliminary |= self.of_preliminary
                self.job = None if self.of_preliminary else self.request.number  # never a part of a finished image
                self.unfinished = [tuple(region) for region in event["regions"]]
            elif event["event"] == "arrays":
                self._put(event["prepared"])
            else:
                self.problem, self.remedy = event.get("text", ""), event.get("remedy", "")
                self.request, self.preliminary = None, self.of_preliminary
                if self.preliminary and not self.problem:
                    PREPARATION.follow(self.log, None)
                    PREPARATION.begin(self.worker)

    def _put(self, part: ViewPart) -> None:
        if part.bottom is not None:  # bands of a region come from the top
            left, _, right, bottom = self.unfinished[0]
            self.unfinished[:1] = [(left, part.bottom, right, bottom)] if part.bottom < bottom else []
        here = part.rows, part.columns
        self.shows_outside = bool(self.outside)
        self.linear[here], self.srgb[here] = part.linear, part.srgb
        if part.unsupported is not None and self.unsupported is not None:
            self.unsupported[here] = part.unsupported
        if part.confidence is not None and self.confidence is not None:
            self.confidence[here] = part.confidence
        self.revision, self.fresh = self.revision + 1, False

    def draw(self, engine: bpy.types.RenderEngine, scene: bpy.types.Scene, region: bpy.types.Region) -> None:
        """Show the image, and the recorded one where that is wanted."""
        self.comparison.stands_in = self.stands_in
        self.comparison.gather()
        gpu.state.blend_set("ALPHA_PREMULT")
        engine.bind_display_space_shader(scene)
        size = region.width, region.height
        finished = not self.pending and not self.problem and not self.preliminary
        stale = self.pending and self.fresh
        with gpu.matrix.push_pop(), gpu.matrix.push_pop_projection():
            gpu.matrix.load_identity()
            gpu.matrix.load_projection_matrix(exact_pixels(*gpu.state.viewport_get()[2:]))
            shown = self.linear, self.srgb, self.unsupported, self.confidence, self.revision
            self.comparison.draw(self.rectangle, size, *shown, finished, stale, self.shows_outside)
        engine.unbind_display_space_shader()
        gpu.state.blend_set("NONE")

    @property
    def stands_in(self) -> bool:
        """Whether there is nothing yet of what is looked at, so that the recorded image is shown."""
        first = self.pending and self.fresh and (self.waits_for_surfels or not self.srgb.any())
        return bool(self.log) and not self.problem and (self.stopped or first)

    @property
    def sentence(self) -> str:
        """State of the view, in one line."""
        if self.problem:
            return self.problem
        parts = (localized(self.comparison.sentence), localized(self.outside), self.work or self.warning, self.clipped)
        return ". ".join(part for part in parts if part)

    @property
    def activity(self) -> str:
        """What of the state the overlays do not say."""
        return ". ".join(part for part in (self.work, self.clipped) if part and not self.problem)

    @property
    def work(self) -> str:
        """What is done now."""
        waits = localized(PREPARATION.text) if self.waits_for_surfels else ""
        return waits or self.progress or (interface("Rendering") if self.pending else "")

    @property
    def clipped(self) -> str:
        """Whether the image is clipped to what was observed, as a sentence."""
        clips = self.wanted is not None and self.wanted["clip"]
        return interface("Clipped to what was observed") if clips else ""


def exact_pixels(width: int, height: int) -> Matrix:
    """Return the projection (4, 4) of a region's pixels without Blender's offset of 0.01 pixels.

    A texture is drawn with linear filtering, of linear colours: a hundredth of a bright pixel is seen in a
    dark one beside it.
    """
    return Matrix(((2 / width, 0, 0, -1), (0, 2 / height, 0, -1), (0, 0, -0.01, 0), (0, 0, 0, 1)))


def onlooker(context: bpy.types.Context, frames: int) -> SampledObject:
    """The viewport itself as a camera that stands still."""
    region, space = context.region, context.region_data
    p = np.array(space.window_matrix, float)
    w, h = region.width, region.height
    model = CameraModel(w, h, w / 2 * p[0, 0], h / 2 * p[1, 1], w / 2 * (1 - p[0, 2]), h / 2 * (1 + p[1, 2]))
    poses = np.repeat(np.array(space.view_matrix.inverted(), float)[None], frames, 0)
    return SampledObject("viewport", "NONE", "", "", "", "", "", 0, poses, np.ones(frames, bool), model)


def camera_rectangle(context: bpy.types.Context, scene: bpy.types.Scene) -> tuple[int, int, int, int]:
    """Left, bottom, width, height of the camera's frame in the region."""
    camera = scene.camera
    corners = [camera.matrix_world @ corner for corner in camera.data.view_frame(scene=scene)]
    points = [location_3d_to_region_2d(context.region, context.region_data, corner) for corner in corners]
    xs, ys = [point.x for point in points], [point.y for point in points]
    # the size is rounded by itself: one camera's frame is as large wherever it stands in the region
    return round(min(xs)), round(min(ys)), max(1, round(max(xs) - min(xs))), max(1, round(max(ys) - min(ys)))
