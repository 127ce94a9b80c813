"""What the worker can be asked for: what it is, pictures, sweeps. Each job is a generator of events."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..drive import CameraModel, Drive
from ..edits import apply_scenario
from ..errors import ScenarioError
from ..frames import CameraFrame
from ..prepare.renderers import make_tracer, pick_device, stamp
from ..prepare.scenario import recorded_drive, scene_actors
from ..render import Region, Renderer
from ..scenario import scenario_from_json
from ..scenario.types import Scenario
from .about import about
from .protocol import Message
from .server import Job

BAND_RAYS = 16384
"""Pixels that are rendered and shown at once: half a second on two cores."""
NOW = 0
"""The number of the one frame of a request."""


class Jobs:
    """The jobs, and what they keep: drives and trained scenes that were read once. ``folder`` is where pixels are left."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.scenes: dict[object, Any] = {}
        self.recorded: dict[object, Drive] = {}
        self.numbers = itertools.count()

    def about(self, request: Message) -> Iterator[Message]:
        """What this interpreter has."""
        yield {"event": "about", **about()}

    def camera(self, request: Message) -> Iterator[Message]:
        """A picture, in bands of rows from the top.

        Of the request: ``scenario`` (its document), ``path`` (what its paths are relative to), ``camera``, ``time_s``, ``model``,
        ``passes``, ``quality``, ``device``; ``rows`` and ``columns`` (first, past the last) where not all are wanted; ``coarse``,
        widths at which the whole view is rendered first; ``shadows``. Events have arrays of rgb and the passes, and which
        ``rows`` they are.
        """
        scenario, drive = self._drive(request)
        name, passes = str(request["camera"]), tuple(request.get("passes", ("rgb",)))
        model = CameraModel.from_dict(request["model"])
        camera = replace(drive.cameras[name], model=model, time_s={NOW: float(request["time_s"])})
        renderer = self._renderer(request, scenario, replace(drive, cameras={name: camera}, lidars={}))
        for width in request.get("coarse", ()):
            picture = renderer.camera(name, NOW, passes, min(int(width), model.width))
            yield self._leave(_arrays(picture), instances=list(picture.instances), rows=None)
        first, last = request.get("rows") or (0, model.height)
        left, right = request.get("columns") or (0, model.width)
        step = max(1, BAND_RAYS // (right - left))
        for top in range(first, last, step):
            bottom = min(top + step, last)
            picture = renderer.camera(name, NOW, passes, region=Region(left, top, right, bottom))
            yield self._leave(_arrays(picture), instances=list(picture.instances), rows=[top, bottom])

    def lidar(self, request: Message) -> Iterator[Message]:
        """A sweep of ``lidar`` at ``time_s``: points (N, 3) in the world, intensity, depth, instance of beams that return."""
        scenario, drive = self._drive(request)
        name = str(request["lidar"])
        lidar = replace(drive.lidars[name], time_s={NOW: float(request["time_s"])})
        sweep = self._renderer(request, scenario, replace(drive, cameras={}, lidars={name: lidar})).lidar(name, NOW)
        at = sweep.returned
        points = sweep.origins[at] + sweep.directions[at] * sweep.depth_m[at][:, None]
        arrays = {"points": points, "intensity": sweep.intensity[at], "depth": sweep.depth_m[at], "instance": sweep.instance[at]}
        yield self._leave(arrays, instances=list(sweep.instances))

    def _drive(self, request: Message) -> tuple[Scenario, Drive]:
        scenario = scenario_from_json(request["scenario"], Path(request["path"]))
        if scenario.scene_path is None:
            raise ScenarioError(f"{scenario.log_path}: has no trained scene to render with: import one, or train one")
        key = scenario.log_path, stamp(scenario.scene_path)
        if key not in self.recorded:
            self.recorded = {key: recorded_drive(scenario)}
        return scenario, apply_scenario(scenario, self.recorded[key], scene_actors)

    def _renderer(self, request: Message, scenario: Scenario, drive: Drive) -> Renderer:
        assert scenario.scene_path is not None  # `_drive` has seen to it
        device, quality = pick_device(str(request.get("device", "cpu"))), str(request.get("quality", "balanced"))
        tracer = make_tracer(scenario.scene_path, drive, quality, device, self.scenes)
        return Renderer(tracer, drive, shadows=bool(request.get("shadows")))

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


def _arrays(picture: CameraFrame) -> dict[str, NDArray[Any]]:
    """A picture's colours and the passes that it has."""
    names = ("rgb", "depth_m", "z_depth_m", "normal", "instance", "opacity", "unsupported")
    return {name: value for name in names if (value := getattr(picture, name)) is not None}


def all_jobs(folder: Path) -> dict[str, Job]:
    """Every job by the name that requests have for it."""
    jobs = Jobs(folder)
    return {"about": jobs.about, "camera": jobs.camera, "lidar": jobs.lidar}
