"""The worker's jobs and its loop. Jobs are images, sweeps, and what the interpreter has; each is a generator of events.
One job runs at a time, and between its events the loop checks whether it was cancelled.

A request holds the state of the world and the sensor (`prepare/capture_request.py`). The worker keeps loaded scenes; it
reads neither scenarios nor logs, except the log that surfels are built from.
"""

from __future__ import annotations

import itertools
import os
import queue
import sys
import threading
import traceback
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..data.log import Log
from ..errors import UnisimError, in_a_line, remedy_of, short, what_is_missing
from ..formats.readers import drive_in, open_log
from ..prepare.renderers import UNTRAINED_DEFAULT, detail_of
from ..render.changes import RenderedState, changed_regions, joined_where_cheaper
from ..render.confidence import RecordedDepth
from ..render.fixers import RecordedFixer, fixer_named
from ..render.lattice import Region
from ..render.observed_space import ObservedSpace, Observing, cache_space, cached_space, observe_space
from ..render.plane_fill import PlaneFill
from ..render.recorded_depth import trace_recorded
from ..render.recorded_detail import RecordedDetail
from ..render.renderer import Renderer
from ..render.traced_planes import trace_planes
from ..render.tracers.surfels.build import Step, preliminary_surfels
from ..render.tracers.surfels.cache import surfels_of
from ..render.tracers.surfels.model import SurfelScene
from ..render.visibility import seen_by
from ..scenes.recipe import Loaded, load_backend, pick_device
from ..scenes.scene import OpenScenes, Scene
from ..world.drive import Camera, Lidar
from ..world.encoding import EncodingError, decode_sensor, decode_state
from ..world.replay import WorldState
from .about import about
from .boxes import BoxJobs
from .protocol import WorkerJob, WorkerMessage, number_of, read_message, write_message

BAND_PIXELS = 32768
"""Pixels of a band, between which a request can be cancelled: 0.1 s on two cores."""
PREVIEWED = 0.1
"""A smaller part of an image has no previews."""
RENDERED_BY = ("sensor", "time_s", "log", "scene", "quality", "device", "shadows", "fill", "detail", "clip", "passes")
"""Members of a request that an image depends on beside its state. Scenes of actors are members of the state."""
PRELIMINARY_REACH_S = 0.25
"""Time, seconds, about that of preliminary surfels in which they are rendered."""
MOST_RENDERED = 16
"""Number of images whose states are remembered: several views' last ones."""


class Jobs:
    """The jobs, and what they keep between requests: loaded scenes, surfels, observed space. Arrays are written
    into ``folder``."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.scenes, self.loaded = OpenScenes(), Loaded()
        self.log: Log | None = None
        self.surfels: SurfelScene | None = None
        self.preliminary: tuple[float, SurfelScene] | None = None
        """Surfels for first images, and the time, seconds, near which they were recorded."""
        self.spaces: dict[Scene, ObservedSpace] = {}
        self.depths: dict[Scene, RecordedDepth] = {}
        self.fills: dict[Scene, PlaneFill] = {}
        self.details: dict[tuple[Scene, str, str, str], RecordedDetail] = {}
        self.build: Iterator[Step | SurfelScene] | None = None
        self.first_build: tuple[float, Iterator[Step | SurfelScene]] | None = None
        self.rendered: dict[int, RenderedState] = {}
        """By requests' numbers, the inputs of images that were updated, oldest first."""
        self.numbers = itertools.count()

    def about(self, request: WorkerMessage) -> Iterator[WorkerMessage]:
        """Report versions, devices and memory (`about.about`)."""
        yield {"event": "about", **about()}

    def camera(self, request: WorkerMessage) -> Iterator[WorkerMessage]:
        """Render an image, in bands of rows from the top.

        The request has the members of `capture_request`, ``passes``, ``quality``, ``device``,
        ``shadows``, ``fill`` and ``detail``, and optionally:

        - ``rows``, ``columns``: (first, past the last) of the region to render; the whole image without them.
        - ``update``: an image is there that lacks nothing but the ``unfinished`` regions (left, top, right, bottom) of
          the image of request ``job``. What can differ from it is rendered; all of the image, if ``job`` is None. The
          first event is then ``regions``: those that are rendered.
        - ``coarse``: strides of low-resolution previews, which small regions have not.
        - ``preliminary``: where the log's surfels are not built, render those nearest to the time alone. The event
          ``regions`` has ``preliminary`` then.
        - ``clip``: show only what the recording observed (`observed_space`). Other pixels are ``unsupported``, and
          their colours mean nothing.

        Events have arrays of rgb and the passes (previews: rgb and ``unsupported`` alone), the ``rows`` and ``columns``
        that they cover, and the ``origin`` and ``stride`` of their pixels, both (row, column). ``progress`` events come
        before them while something has to be built first.
        """
        camera = decode_sensor(_text(request, "sensor"))
        if not isinstance(camera, Camera):
            raise EncodingError(f"an image is asked for of LiDAR {camera.sensor_id!r}")
        renderer = yield from self._renderer(request)
        state, time_s = _seen_state(request, renderer, camera)
        preliminary = self.surfels is None and request.get("scene") is None
        passes, model = tuple(request.get("passes", ("rgb",))), camera.model
        first, last = request.get("rows") or (0, model.height)
        left, right = request.get("columns") or (0, model.width)
        regions = [Region(left, first, right, last)]
        if "update" in request:
            if not preliminary:
                regions = self._regions_to_update(request, renderer, state, camera)
            yield {"event": "regions", "regions": regions, "preliminary": preliminary}
        area = sum(region.area for region in regions)
        coarse = request.get("coarse", ()) if area >= PREVIEWED * model.width * model.height else ()
        for region in regions:
            band = max(1, BAND_PIXELS // (region.right - region.left))
            for part in renderer.progressive(state, camera, time_s, passes, region, coarse, band):
                covered = part.region
                yield self._leave(
                    part.frame.arrays(), instances=list(part.frame.instances), origin=part.origin, stride=part.stride,
                    rows=[covered.top, covered.bottom], columns=[covered.left, covered.right],
                )  # fmt: skip

    def _regions_to_update(
        self, request: WorkerMessage, renderer: Renderer, state: WorldState, camera: Camera
    ) -> list[Region]:
        """Return the regions of an image that differ from the one that is there, see `camera`; remember the image's state."""
        update, number = request["update"], number_of(request, "id")
        after = RenderedState(state, tuple(map(request.get, RENDERED_BY)), renderer.margin(state))
        before = self.rendered.get(number_of(update, "job"))
        self.rendered[number] = after
        while len(self.rendered) > MOST_RENDERED:
            del self.rendered[next(iter(self.rendered))]
        regions = None if before is None else changed_regions(renderer, before, after, camera)
        if regions is None:
            return [Region.of_image(camera.model)]
        return joined_where_cheaper([*regions, *(Region(*part) for part in update["unfinished"])])

    def lidar(self, request: WorkerMessage) -> Iterator[WorkerMessage]:
        """Render a sweep of the members of `capture_request`: points (N, 3) in the world, intensity, depth, instance and
        cell (column * beams + ring) (N,) of the beams that return; ``dropped_origins``, ``dropped_directions`` (M, 3)
        and ``dropped_cell`` (M,) of those that do not. The event also has the number of ``beams``, and id and class of
        the ``actors`` that instances count from 1."""
        lidar = decode_sensor(_text(request, "sensor"))
        if not isinstance(lidar, Lidar):
            raise EncodingError(f"a sweep is asked for of camera {lidar.sensor_id!r}")
        renderer = yield from self._renderer(request)
        state, time_s = _seen_state(request, renderer, lidar)
        sweep = renderer.render(state, lidar, time_s)
        at, dropped = sweep.returned, ~sweep.returned if lidar.blocked is None else ~sweep.returned & ~lidar.blocked
        beams, columns = at.shape
        cell = (np.arange(columns) * beams + np.arange(beams)[:, None]).astype(np.int32)
        arrays = {
            "points": sweep.origins[at] + sweep.directions[at] * sweep.depth_m[at][:, None],
            "intensity": sweep.intensity[at],
            "depth": sweep.depth_m[at],
            "instance": sweep.instance[at],
            "cell": cell[at],
            "dropped_origins": sweep.origins[dropped].astype(np.float32),
            "dropped_directions": sweep.directions[dropped].astype(np.float32),
            "dropped_cell": cell[dropped],
        }
        labels = {actor.uid: actor.label for actor in state.actors}
        yield self._leave(arrays, beams=beams, actors=[[uid, labels[uid]] for uid in sweep.instances])

    def _renderer(self, request: WorkerMessage) -> Generator[WorkerMessage, None, Renderer]:
        """Return the renderer of a request: of its trained scene, or of the log's surfels if it names none."""
        device, quality = pick_device(str(request.get("device", "cpu"))), str(request.get("quality", "balanced"))
        shadows = bool(request.get("shadows"))
        if request.get("scene") is not None:
            scene = self.scenes.open(_text(request, "scene"))
            others = {str(name): self.scenes.open(str(name)) for name in request.get("others", ())}
            backend = load_backend(scene, others, quality, device, self.loaded)
            depth = None
            fill = fixer = None
            how = str(request.get("fill", "none"))
            if how != "none" and isinstance(backend, Observing):
                fill = yield from self._fill(backend, scene)
                if fixer_named(how) is not None:
                    fixer = RecordedFixer(how, open_log(_text(request, "log")), scene.header.drive.cameras)
            if (fixer or "confidence" in request.get("passes", ())) and isinstance(backend, Observing):
                depth = yield from self._recorded_depth(backend, scene)
            detail = None
            if request.get("detail") and isinstance(backend, Observing):
                path = _text(request, "log")
                key = scene, path, quality, device
                if key not in self.details:
                    self.details = {key: detail_of(backend, scene, open_log(path))}
                detail = self.details[key]
            clip = bool(request.get("clip"))
            if (clip or "unsupported" in request.get("passes", ())) and isinstance(backend, Observing):
                space = yield from self._space(backend, scene)
                return Renderer(backend.within(space, clip), shadows, backend, depth, fill, fixer, detail)
            return Renderer(backend, shadows, recorded_depth=depth, fill=fill, fixer=fixer, detail=detail)
        else:
            log = self._log(request)
            first = request.get("preliminary") and self.surfels is None
            surfels = yield from self._first_surfels(request, log) if first else self._surfels(log)
            backend = UNTRAINED_DEFAULT.backend(surfels, log, quality=quality)
        return Renderer(backend, shadows)

    def _recorded_depth(self, backend: Observing, scene: Scene) -> Generator[WorkerMessage, None, RecordedDepth]:
        """Return the distances of a trained scene's recording; yields events of progress while they are traced."""
        if scene not in self.depths:
            for step in trace_recorded(backend, backend.observed[0]):
                if isinstance(step, RecordedDepth):
                    self.depths = {scene: step}
                else:
                    yield {"event": "progress", "text": "Working out what was observed", "share": step}
        return self.depths[scene]

    def _fill(self, backend: Observing, scene: Scene) -> Generator[WorkerMessage, None, PlaneFill]:
        """Return the filled ground and façades of a trained scene; yields events of progress while it is computed."""
        if scene not in self.fills:
            for step in trace_planes(backend):
                if isinstance(step, PlaneFill):
                    self.fills = {scene: step}
                else:
                    yield {"event": "progress", "text": "Filling the ground", "share": step}
        return self.fills[scene]

    def _space(self, backend: Observing, scene: Scene) -> Generator[WorkerMessage, None, ObservedSpace]:
        """Return the space that a trained scene's recording observed; yields events of progress
        while it is computed."""
        if scene not in self.spaces:
            header, shown, voxel_m = backend.observed
            space = cached_space(header, shown, voxel_m)
            if space is None:
                for step in observe_space(backend, header, shown, voxel_m):
                    if isinstance(step, ObservedSpace):
                        space = step
                    else:
                        yield {"event": "progress", "text": "Working out what was observed", "share": step}
                assert space is not None
                cache_space(header, space)
            self.spaces = {scene: space}
        return self.spaces[scene]

    def prepare(self, request: WorkerMessage) -> Iterator[WorkerMessage]:
        """Build the surfels of a request's log; yields events of progress."""
        yield from self._surfels(self._log(request))

    def _log(self, request: WorkerMessage) -> Log:
        """Return a request's log. Its surfels are there if they are cached on disk."""
        path = drive_in(Path(_text(request, "log")))
        if self.log is None or self.log.path != path:
            log = open_log(path)
            build = surfels_of(log, UNTRAINED_DEFAULT.settings)
            first = next(build)
            self.log, self.surfels, self.build = log, None, build
            self.preliminary = self.first_build = None
            if isinstance(first, SurfelScene):
                self.surfels, self.build = first, None
        return self.log

    def _surfels(self, log: Log) -> Generator[WorkerMessage, None, SurfelScene]:
        """Return a log's surfels; yields events of progress while they are built. If the request is cancelled, the next
        one continues the build."""
        if self.surfels is None:
            self.build = self.build or surfels_of(log, UNTRAINED_DEFAULT.settings)
            try:
                self.surfels = yield from _built(self.build)
                self.preliminary = self.first_build = None
            finally:
                # a failed build starts again; a cancelled one continues
                if getattr(self.build, "gi_frame", None) is None:
                    self.build = None
        return self.surfels

    def _first_surfels(self, request: WorkerMessage, log: Log) -> Generator[WorkerMessage, None, SurfelScene]:
        """Return the preliminary surfels of a request's time, as `_surfels` does."""
        time_s = _time(request)
        if self.preliminary is None or abs(self.preliminary[0] - time_s) > PRELIMINARY_REACH_S:
            if self.first_build is None or abs(self.first_build[0] - time_s) > PRELIMINARY_REACH_S:
                self.first_build = time_s, preliminary_surfels(log, UNTRAINED_DEFAULT.settings, time_s)
            time_s, steps = self.first_build
            try:
                self.preliminary = time_s, (yield from _built(steps))
            finally:
                if getattr(steps, "gi_frame", None) is None:
                    self.first_build = None
        return self.preliminary[1]

    def _leave(self, arrays: dict[str, NDArray[Any]], **more: Any) -> WorkerMessage:
        """Write arrays into one file; return the event that says where in it each of them lies."""
        path = self.folder / f"{next(self.numbers)}.raw"
        places, offset = {}, 0
        with path.open("wb") as file:
            for key, array in arrays.items():
                file.write(np.ascontiguousarray(array).data)
                places[key] = {"dtype": array.dtype.str, "shape": list(array.shape), "offset": offset}
                offset += array.nbytes
        return {"event": "arrays", "file": path.name, "arrays": places, **more}


def _built(steps: Iterator[Step | SurfelScene]) -> Generator[WorkerMessage, None, SurfelScene]:
    """Return what a build comes to; yields its steps as events, after which other requests may go first: any request continues
    the build."""
    built: SurfelScene | None = None
    for step in steps:
        if isinstance(step, SurfelScene):
            built = step
        else:
            yield {"event": "progress", "text": step.text, "share": step.share, "pauses": True}
    assert built is not None
    return built


def _seen_state(request: WorkerMessage, renderer: Renderer, sensor: Camera | Lidar) -> tuple[WorldState, float]:
    """Return the state that a request's capture can depend on, and its time in seconds. Raises `UnisimError`."""
    state, time_s = decode_state(_text(request, "state")), _time(request)
    if not state.start_s <= time_s <= state.end_s:
        raise UnisimError(
            f"the request's time, {time_s}, is not within its state, {state.start_s:g} to {state.end_s:g} s"
        )
    return state if renderer.backend.sees_all else seen_by(state, sensor, renderer.reach), time_s


def _time(request: WorkerMessage) -> float:
    if not isinstance(time_s := request.get("time_s"), int | float):
        raise UnisimError(f"the request's time, {time_s}, is no number")
    return float(time_s)


def _text(request: WorkerMessage, name: str) -> str:
    if not isinstance(value := request.get(name), str):
        raise UnisimError(f"the request has no {name}: the worker is of another version than the extension")
    return value


def all_jobs(folder: Path) -> dict[str, WorkerJob]:
    """Return the jobs by their names in requests."""
    jobs = Jobs(folder)
    boxes = BoxJobs(jobs._leave)
    return {
        **{"about": jobs.about, "camera": jobs.camera, "lidar": jobs.lidar, "prepare": jobs.prepare},
        **{"follow": boxes.follow, "box_points": boxes.box_points},
    }


class Server:
    """Runs requests in the order in which they arrive; one that ``pauses`` goes behind those that have arrived since.
    ``jobs`` are the jobs by their names in requests."""

    def __init__(self, requests: BinaryIO, events: BinaryIO, jobs: dict[str, WorkerJob]) -> None:
        self.requests, self.events, self.jobs = requests, events, jobs
        self.waiting: queue.SimpleQueue[WorkerMessage | None] = queue.SimpleQueue()
        self.cancelled: set[int] = set()

    def run(self) -> None:
        """Run requests until the other end is closed."""
        threading.Thread(target=self._listen, daemon=True).start()
        while (request := self.waiting.get()) is not None:
            self._do(request)

    def _listen(self) -> None:
        """Read requests in a thread of its own, so that a job at work hears of its cancellation, and of
        the end of Blender."""
        while (request := read_message(self.requests)) is not None:
            if request.get("do") == "cancel":
                self.cancelled.add(number_of(request, "job"))
            else:
                self.waiting.put(request)
        # nobody is left to render for: the job at hand need not end first
        os._exit(0)

    def _do(self, request: WorkerMessage) -> None:
        number, name, paused = number_of(request, "id"), str(request.get("do")), False
        try:
            if name not in self.jobs:
                raise UnisimError(f"the worker knows no {short(name)}: it is of another version than the extension")
            if number not in self.cancelled:
                for event in self.jobs[name](request):
                    self._tell(number, event)
                    if number in self.cancelled:
                        break
                    if paused := bool(event.get("pauses")) and not self.waiting.empty():
                        self.waiting.put(request)
                        return
            self._tell(number, {"event": "cancelled" if number in self.cancelled else "done"})
        except UnisimError as fault:
            self._tell(number, {"event": "error", "text": str(fault), "remedy": fault.remedy})
        except MemoryError:
            self._tell(number, {"event": "error", "text": "the worker has no memory left for this"})
        except Exception as fault:
            missing, remedy = "", ""
            if isinstance(fault, ImportError):
                missing, remedy = what_is_missing(fault), remedy_of(fault)
            traceback.print_exc(file=sys.stderr)
            text = missing or f"{type(fault).__name__}: {in_a_line(fault)}"
            self._tell(number, {"event": "error", "text": text, "remedy": remedy})
        finally:
            if not paused:
                self.cancelled.discard(number)

    def _tell(self, number: int, event: WorkerMessage) -> None:
        write_message(self.events, {"id": number, **event})
