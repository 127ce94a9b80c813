"""One image or sweep as a request to the worker: the scenario of a moment, and the sensor that records it."""

from __future__ import annotations

import tempfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...core.scenario import scenario_to_json
from ...core.scenario.sensors import CameraSpec, Sensors
from ...core.scenario.types import Scenario
from ...core.world.drive import CameraModel
from ..edits.trajectories import keyframes
from ..readers.sensors import intrinsics
from ..sampled.clock import Clock
from ..sampled.poses import optical
from ..sampled.scene import Sampled, SampledObject
from ..sampled.source import Source
from ..sensors.mounts import sensor_times
from ..sensors.names import sensor_id
from .scenario import read_scenario

HERE = Path(tempfile.gettempdir()).resolve() / "moment.json"
"""Where the scenario of the moment would lie; nothing is written there."""


def camera_request(
    sampled: Sampled, view: SampledObject, source: Source, frame: float, size: tuple[int, int], aspect: float = 1.0
) -> dict[str, Any]:
    """What the worker needs for an image of size (width, height) through ``view``; ``aspect``: a pixel's height by its width."""
    scenario = read_scenario(only(sampled, view), source, HERE)
    clock, drive = Clock.of(source.drive), source.drive
    recorded = drive.cameras.get(view.uid) if view.kind == "CAMERA" else None
    time_s = float(clock.time_s(np.array(frame)))
    if view.kind != "CAMERA":
        here = keyframes(sampled.clock, optical(view.poses), np.ones(len(view.poses), bool))
        assert view.camera is not None
        scenario = replace(
            scenario, sensors=Sensors((CameraSpec(sensor_id(view, drive), **intrinsics(view.camera), trajectory=here),), ())
        )
    if recorded is not None:
        at = Clock(np.array([frame, frame + 1.0]), np.array([time_s, time_s + 1 / clock.rate]))
        time_s = float(sensor_times(at, recorded.time_s)[0])
    assert view.camera is not None
    return {
        **about(scenario),
        "camera": sensor_id(view, drive),
        "time_s": time_s,
        "model": asdict(sized(view.camera, size, aspect, recorded is not None)),
        "indices": indices(sampled),
    }


def indices(sampled: Sampled) -> dict[str, int]:
    """Blender's pass index of each actor, by the id that a scenario has for it."""
    actors = list(sampled.of("ACTOR", "BODY"))
    return {**{thing.uid: thing.index for thing in actors if thing.is_original}, **{thing.title: thing.index for thing in actors}}


def lidar_request(sampled: Sampled, lidar: SampledObject, source: Source, frame: float) -> dict[str, Any]:
    """What the worker needs for a sweep of ``lidar``."""
    scenario = read_scenario(only(sampled, lidar), source, HERE)
    recorded = source.drive.lidars.get(lidar.uid)
    clock = Clock.of(source.drive)
    time_s = float(clock.time_s(np.array(frame)))
    if recorded is not None:
        time_s = recorded.time_s.get(int(frame), time_s)
    return {**about(scenario), "lidar": sensor_id(lidar, source.drive), "time_s": time_s}


def about(scenario: Scenario) -> dict[str, Any]:
    """A scenario as a request holds it."""
    return {"scenario": scenario_to_json(scenario), "path": str(scenario.path)}


def only(sampled: Sampled, sensor: SampledObject) -> Sampled:
    """The same without the other sensors. The one that looks is there, though it may be hidden for renders."""
    others = [thing for thing in sampled.objects if thing.kind not in ("CAMERA", "LIDAR", "NONE")]
    looks = [replace(thing, there=np.ones_like(thing.there)) for thing in sampled.objects if thing.name == sensor.name]
    return replace(sampled, objects=tuple(sorted([*others, *looks], key=lambda thing: thing.name)))


def sized(model: CameraModel, size: tuple[int, int], aspect: float, exact: bool) -> CameraModel:
    """A camera's intrinsics at another size (width, height). One of the rig keeps its own wherever the image has its shape;
    else the view is as Blender frames it: as wide as the lens says, whatever the height."""
    width, height = size
    sx, sy = width / model.width, height / model.height
    if exact and abs(model.height * sx - height) <= 1.0:
        return replace(model, width=width, height=height, fx=model.fx * sx, fy=model.fy * sy, cx=model.cx * sx, cy=model.cy * sy)
    return replace(
        model, width=width, height=height, fx=model.fx * sx, fy=model.fx * sx / aspect,
        cx=model.cx * sx, cy=height / 2 + (model.cy - model.height / 2) * sx / aspect,
    )  # fmt: skip
