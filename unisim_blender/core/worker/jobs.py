"""What the worker can be asked for: what it is, images, sweeps. Each job is a generator of events."""

from __future__ import annotations

import itertools
from collections.abc import Generator, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..data import open_log
from ..data.log import Log
from ..prepare.capabilities import capability_warnings
from ..prepare.renderers import (
    UNTRAINED,
    UNTRAINED_DEFAULT,
    make_backend,
    other_scenes,
    pick_device,
    stamp,
    untrained_backend,
)
from ..prepare.scenario import recorded_drive, scene_actors
from ..render.drive_renderer import DriveRenderer
from ..render.observed_space import ObservedSpace, Observing, keep_space, kept_space, observe_space
from ..render.regions import Region
from ..render.renderer import Renderer
from ..render.tracers.surfels.build import Step
from ..render.tracers.surfels.cache import surfels_of
from ..render.tracers.surfels.model import SurfelScene
from ..scenario import apply_scenario, scenario_from_json
from ..scenario.types import Scenario
from ..sensors.frames import CameraFrame
from ..world.drive import CameraModel, Drive
from .about import about
from .protocol import Job, Message

BAND_PIXELS = 32768
"""So many are rendered and shown at once, where Esc is heard between: 0.1 s on two cores."""
NOW = 0
"""The number of the one frame of a request."""


class Jobs:
    """The jobs, and what they keep: drives and trained scenes that were read once, surfels. ``folder`` is where pixels are
    left."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.scenes: dict[object, Any] = {}
        self.recorded: dict[object, Drive] = {}
        self.log: Log | None = None
        self.surfels: SurfelScene | None = None
        self.spaces: dict[object, ObservedSpace] = {}
        self.build: Iterator[Step | SurfelScene] | None = None
        self.numbers = itertools.count()

    def about(self, request: Message) -> Iterator[Message]:
        """What this interpreter has."""
        yield {"event": "about", **about()}

    def camera(self, request: Message) -> Iterator[Message]:
        """An image, in bands of rows from the top.

        Of the request: ``scenario`` (its document), ``path`` (what its paths are relative to), ``camera``, ``time_s``, ``model``,
        ``passes``, ``quality``, ``device``; ``rows`` and ``columns`` (first, past the last) where not all are wanted, and
        ``touched``, whether these are only what an edit can have touched directly; ``coarse``, strides at which it is shown
        first; ``shadows``; ``clip``, whether nothing is shown but what the recording observed (see `observed_space`): what else
        there would be is ``unsupported``, and its colours mean nothing. Events have arrays of rgb and the passes, coarse ones of
        rgb and ``unsupported`` alone; the ``rows`` and ``columns`` that they cover, and where in these they have pixels: at
        ``origin`` and every ``stride`` from there, both as (row, column). Before them, ``warning`` says what the scene's method
        cannot show, and ``progress`` how far something is that has to be made first.
        """
        scenario, drive = self._drive(request)
        yield from self._warnings(scenario, drive, sweeps=False)
        name, passes = str(request["camera"]), tuple(request.get("passes", ("rgb",)))
        model = CameraModel.from_dict(request["model"])
        # as `unisim render` resizes a camera: its own width decides how finely an image is traced
        own = drive.cameras[name].model.width
        camera = replace(drive.cameras[name], model=model, time_s={NOW: float(request["time_s"])}, full_width=own)
        renderer = yield from self._renderer(request, scenario, replace(drive, cameras={name: camera}, lidars={}))
        first, last = request.get("rows") or (0, model.height)
        left, right = request.get("columns") or (0, model.width)
        region = Region(left, first, right, last)
        if request.get("touched"):
            state = renderer.state(camera, camera.time_s[NOW])
            region = renderer.renderer.dilated(state, region).within_image(model)
        band, coarse = max(1, BAND_PIXELS // (region.right - region.left)), request.get("coarse", ())
        for part in renderer.progressive(name, NOW, passes, region=region, coarse=coarse, band=band):
            covered = part.region
            yield self._leave(
                _arrays(part.frame), instances=list(part.frame.instances), origin=part.origin, stride=part.stride,
                rows=[covered.top, covered.bottom], columns=[covered.left, covered.right],
            )  # fmt: skip

    def lidar(self, request: Message) -> Iterator[Message]:
        """A sweep of ``lidar`` at ``time_s``: points (N, 3) in the world, intensity, depth, instance of beams that return."""
        scenario, drive = self._drive(request)
        yield from self._warnings(scenario, drive, sweeps=True)
        name = str(request["lidar"])
        lidar = replace(drive.lidars[name], time_s={NOW: float(request["time_s"])})
        renderer = yield from self._renderer(request, scenario, replace(drive, cameras={}, lidars={name: lidar}))
        sweep = renderer.lidar(name, NOW)
        at = sweep.returned
        points = sweep.origins[at] + sweep.directions[at] * sweep.depth_m[at][:, None]
        arrays = {"points": points, "intensity": sweep.intensity[at], "depth": sweep.depth_m[at], "instance": sweep.instance[at]}
        yield self._leave(arrays, instances=list(sweep.instances))

    def _drive(self, request: Message) -> tuple[Scenario, Drive]:
        scenario = scenario_from_json(request["scenario"], Path(request["path"]))
        # a log's own files are not looked at again: reading it takes a second
        key = scenario.log_path, None if scenario.scene_path is None else stamp(scenario.scene_path)
        if key not in self.recorded:
            self.recorded = {key: recorded_drive(scenario)}
        return scenario, apply_scenario(scenario, self.recorded[key], scene_actors)

    def _warnings(self, scenario: Scenario, drive: Drive, sweeps: bool) -> Iterator[Message]:
        """What comes out otherwise than the edits ask for."""
        if scenario.scene_path is not None:
            (recorded,) = self.recorded.values()
            for sentence in capability_warnings(scenario.scene_path, recorded, drive, sweeps):
                yield {"event": "warning", "text": sentence}

    def _renderer(self, request: Message, scenario: Scenario, drive: Drive) -> Generator[Message, None, DriveRenderer]:
        """The renderer of a request: of its trained scene, or of the log's surfels where it has none."""
        device, quality = pick_device(str(request.get("device", "cpu"))), str(request.get("quality", "balanced"))
        shadows = bool(request.get("shadows"))
        if scenario.scene_path is not None:
            backend = make_backend(scenario.scene_path, other_scenes(drive), quality, device, self.scenes)
            clip = bool(request.get("clip"))
            if (clip or "unsupported" in request.get("passes", ())) and isinstance(backend, Observing):
                space = yield from self._space(backend, stamp(scenario.scene_path))
                return DriveRenderer(Renderer(backend.within(space, clip), shadows, backend), drive)
        else:
            log, surfels = yield from self._surfels(scenario.log_path)
            backend = untrained_backend(UNTRAINED_DEFAULT, surfels, log, quality=quality)
        return DriveRenderer(Renderer(backend, shadows), drive)

    def _space(self, backend: Observing, key: object) -> Generator[Message, None, ObservedSpace]:
        """What a trained scene's recording observed, and events of how far that is worked out."""
        if key not in self.spaces:
            header, shown, voxel_m = backend.observed
            space = kept_space(header, shown, voxel_m)
            if space is None:
                for step in observe_space(backend, header, shown, voxel_m):
                    if isinstance(step, ObservedSpace):
                        space = step
                    else:
                        yield {"event": "progress", "text": "Working out what was observed", "share": step}
                assert space is not None
                keep_space(header, space)
            self.spaces = {key: space}
        return self.spaces[key]

    def _surfels(self, path: Path) -> Generator[Message, None, tuple[Log, SurfelScene]]:
        """A log's surfels, and events of how far they are. A build that is not wanted any more stays where it was: the next
        request goes on with it."""
        if self.log is None or self.log.path != path:
            self.log, self.surfels, self.build = open_log(path), None, None
        if self.surfels is None:
            if self.build is None:
                self.build = surfels_of(self.log, UNTRAINED[UNTRAINED_DEFAULT])
            try:
                for step in self.build:
                    if isinstance(step, SurfelScene):
                        self.surfels = step
                    else:
                        yield {"event": "progress", "text": step.text, "share": step.share}
            finally:
                # what failed begins again; what was only left goes on
                if self.surfels is not None or getattr(self.build, "gi_frame", None) is None:
                    self.build = None
        assert self.surfels is not None
        return self.log, self.surfels

    def _leave(self, arrays: dict[str, NDArray[Any]], **more: Any) -> Message:
        """Write arrays into one file and say where in it each of them lies."""
        path = self.folder / f"{next(self.numbers)}.raw"
        places, offset = {}, 0
        with path.open("wb") as file:
            for key, array in arrays.items():
                file.write(np.ascontiguousarray(array).data)
                places[key] = {"dtype": array.dtype.str, "shape": list(array.shape), "offset": offset}
                offset += array.nbytes
        return {"event": "arrays", "file": path.name, "arrays": places, **more}


def _arrays(image: CameraFrame) -> dict[str, NDArray[Any]]:
    """An image's colours and the passes that it has."""
    names = ("rgb", "depth_m", "z_depth_m", "normal", "instance", "opacity", "unsupported")
    return {name: value for name in names if (value := getattr(image, name)) is not None}


def all_jobs(folder: Path) -> dict[str, Job]:
    """Every job by the name that requests have for it."""
    jobs = Jobs(folder)
    return {"about": jobs.about, "camera": jobs.camera, "lidar": jobs.lidar}
