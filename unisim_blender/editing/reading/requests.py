"""One image or sweep as a request to the worker: the state of the world at a moment, and the sensor that records it.

The edits are those that an export writes. They are applied here, on the recorded drive that is kept: the
worker gets a state.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ...core.errors import UnisimError
from ...core.prepare.capture_request import capture_request
from ...core.scenario import apply_scenario, check_scenario
from ...core.scenario.edits import Lamp
from ...core.scenario.motion.trajectories import SAME_TIME_S
from ...core.scenario.sensors.document import CameraSpec, Sensors
from ...core.scenario.sensors.select import camera_members
from ...core.scenario.types import Scenario
from ...core.scenes.scene import capability_warnings, without_other_scenes
from ...core.world.drive import Camera, CameraModel, Drive, Lidar
from ...core.world.lamps import ActorLamp
from ..edits.trajectories import keyframes
from ..sampled.clock import Clock
from ..sampled.scene import Sampled, SampledObject, optical
from ..sampled.source import OPENED, DriveSource, lamps_of, scene_actors
from ..sensors.names import sensor_id
from ..texts import Text
from .scenario import read_scenario, unreadable_actors

HERE = Path(tempfile.gettempdir()).resolve() / "moment.json"
"""Path that the scenario of a request is relative to; nothing is written there."""


class CameraRequest(NamedTuple):
    """``values`` are what the worker needs, beside what is asked of it; ``model`` is the camera's, at the image's size.
    ``scenario`` is what the image is of, ``indices`` are Blender's pass indices by the actors' ids."""

    values: dict[str, Any]
    model: CameraModel
    scenario: Scenario
    indices: dict[str, int]


RequestT = TypeVar("RequestT")


def camera_request(
    sampled: Sampled, view: SampledObject, source: DriveSource, frame: float, size: tuple[int, int], aspect: float = 1.0
) -> CameraRequest:
    """Return the worker's request for an image of size (width, height) through ``view``; ``aspect``: a pixel's height
    by its width. Raises `UnisimError` for edits that cannot be."""
    scenario = read_scenario(only(sampled, view), source, HERE)
    clock, drive = Clock.of(source.drive), source.drive
    recorded = drive.cameras.get(view.uid) if view.kind == "CAMERA" else None
    if view.kind != "CAMERA":
        here = keyframes(sampled.clock, optical(view.poses), np.ones(len(view.poses), bool))
        assert view.camera is not None
        scenario = replace(
            scenario,
            sensors=Sensors((CameraSpec(sensor_id(view, drive), **camera_members(view.camera), trajectory=here),), ()),
        )
    assert view.camera is not None
    model = sized(view.camera, size, aspect, recorded is not None)
    edited = _walked_on(edited_drive(scenario, source), sampled)
    camera = edited.cameras[sensor_id(view, drive)]
    time_s = clock.capture(camera, frame).time_s(camera)
    # as `unisim render` resizes a camera: its own width decides how finely an image is traced
    camera = replace(camera, model=model, full_width=camera.model.width)
    values = _request(source, edited, camera, time_s)
    if _lamps_shown(scenario, source) is None:
        values["warnings"] = [
            *values["warnings"],
            Text("Lamps are as recorded until Find Lamps has searched the images"),
        ]
    return CameraRequest(values, model, scenario, indices(sampled))


def without_unreadable(
    ask: Callable[[Sampled], RequestT], sampled: Sampled, drive: Drive
) -> tuple[RequestT, tuple[Text, ...]]:
    """Return a view's request of a scene, without the actors that cannot be read, and a sentence on each of these. Raises
    `UnisimError` where there is no request without them either."""
    try:
        return ask(sampled), ()
    except UnisimError:
        faults = unreadable_actors(sampled, drive)
        if not faults:
            raise
    readable = replace(sampled, objects=tuple(obj for obj in sampled.objects if obj.name not in faults))
    left_out = (Text('Left out: "{name}" {fault}', name=name, fault=why) for name, why in faults.items())
    return ask(readable), tuple(left_out)


def indices(sampled: Sampled) -> dict[str, int]:
    """Blender's pass index of each actor, by the id that a scenario has for it."""
    actors = list(sampled.of("ACTOR", "BODY"))
    return {**{obj.uid: obj.index for obj in actors if obj.is_original}, **{obj.title: obj.index for obj in actors}}


def lidar_request(sampled: Sampled, lidar: SampledObject, source: DriveSource, frame: float) -> dict[str, Any]:
    """Return the worker's request for a sweep of ``lidar``."""
    scenario = read_scenario(only(sampled, lidar), source, HERE)
    edited = _walked_on(edited_drive(scenario, source), sampled)
    sensor = edited.lidars[sensor_id(lidar, source.drive)]
    return _request(source, edited, sensor, Clock.of(source.drive).capture(sensor, frame).time_s(sensor))


def _walked_on(edited: Drive, sampled: Sampled) -> Drive:
    """Return an edited drive whose paths begin at the sampled frames with the lengths up to these that an export has."""
    first_s, walked = float(sampled.clock.times_s[0]), {}
    for obj in sampled.of("ACTOR"):
        actor = edited.actors.get(obj.uid if obj.is_original else obj.title)
        if actor is None or not obj.walked_m or actor.world_from_actor.times_s[0] < first_s - SAME_TIME_S:
            continue
        path = actor.world_from_actor
        start = obj.walked_m - float(path.walked_at(first_s))
        walked[actor.uid] = replace(actor, world_from_actor=replace(path, start_walked_m=start))
    return replace(edited, actors={**edited.actors, **walked}) if walked else edited


def edited_drive(scenario: Scenario, source: DriveSource) -> Drive:
    """The recorded drive with a scenario's edits and sensors. Raises `ScenarioError`.

    Views differ in what looks more often than in what is there: the drive of the last edits is kept,
    without its sensors.
    """
    check_scenario(scenario)
    edits, lamps = replace(scenario, sensors=None), _lamps_shown(scenario, source)
    if not _newest or _newest[0][0] is not source or _newest[0][1] != (edits, lamps is None):
        seen = None if lamps is None else lambda: lamps
        _newest[:] = [(source, (edits, lamps is None), apply_scenario(edits, source.drive, scene_actors, seen))]
    # sensors are put on the edited vehicle, after all edits
    return apply_scenario(replace(scenario, edits=(), boxes=None, frames=None), _newest[0][2], scene_actors)


_newest: list[tuple[DriveSource, tuple[Scenario, bool], Drive]] = []
"""The newest drive, and what it was edited from and by."""


def _lamps_shown(scenario: Scenario, source: DriveSource) -> Mapping[str, tuple[ActorLamp, ...]] | None:
    """Return the lamps that a scenario's edits need; None where they were not found before."""
    return lamps_of(source) if any(isinstance(edit, Lamp) for edit in scenario.edits) else {}


def _request(source: DriveSource, edited: Drive, sensor: Camera | Lidar, time_s: float) -> dict[str, Any]:
    """A capture's request, with sentences about what cannot be shown of the edits."""
    scene = source.scene_path
    if scene is None:
        edited, warnings = without_other_scenes(edited)
    else:
        warnings = capability_warnings(OPENED.open(scene), source.drive, edited, isinstance(sensor, Lidar))
    request = capture_request(edited, source.parked, sensor, time_s, source.log_path, scene)
    return {**request, "warnings": warnings}


def only(sampled: Sampled, sensor: SampledObject) -> Sampled:
    """The same without the other sensors. The one that looks is there, though it may be hidden for renders."""
    others = [obj for obj in sampled.objects if obj.kind not in ("CAMERA", "LIDAR", "NONE")]
    looks = [replace(obj, there=np.ones_like(obj.there)) for obj in sampled.objects if obj.name == sensor.name]
    return replace(sampled, objects=tuple(sorted([*others, *looks], key=lambda obj: obj.name)))


def sized(model: CameraModel, size: tuple[int, int], aspect: float, exact: bool) -> CameraModel:
    """A camera's intrinsics at another size (width, height). One of the rig keeps its own wherever the image has its
    shape; else the view is as Blender frames it: as wide as the lens says, whatever the height."""
    width, height = size
    sx, sy = width / model.width, height / model.height
    if exact and abs(model.height * sx - height) <= 1.0:
        return replace(
            model, width=width, height=height, fx=model.fx * sx, fy=model.fy * sy, cx=model.cx * sx, cy=model.cy * sy
        )
    return replace(
        model, width=width, height=height, fx=model.fx * sx, fy=(model.fx if model.is_pinhole else model.fy) * sx / aspect,
        cx=model.cx * sx, cy=height / 2 + (model.cy - model.height / 2) * sx / aspect,
    )  # fmt: skip
