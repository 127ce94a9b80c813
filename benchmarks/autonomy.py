"""The stack of `examples/perception` on a log's recorded sensors beside the same replayed: AP of its tracks, minADE of its
forecasts, and how far apart its plans end.

python -m benchmarks.autonomy LOG WEIGHTS --out FOLDER [--renderer NAME | --scene SCENE]

Open loop: the vehicle is where it was recorded, and the stack sees one frame after another. FOLDER gets the documents that
`unisim metrics` reads, and the metrics.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.detection.samples import LEAST_POINTS, VEHICLES, X_M, Y_M
from benchmarks.detection.testing import CLASS
from examples.perception.candidates import STEP_S
from examples.perception.driver import Perception
from examples.perception.objects import Mode
from examples.perception.sensing import Detectors
from unisim_blender.core.data import open_log
from unisim_blender.core.data.log import Log
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.files import write_file
from unisim_blender.core.geometry import FloatArray, invert_pose, points_in_box, transform_points
from unisim_blender.core.metrics.document import Forecast, FrameKey, FrameOutput, Outputs, write_outputs
from unisim_blender.core.metrics.measure import measure, table
from unisim_blender.core.prepare.scenario_plan import RenderOptions
from unisim_blender.core.scenario.simulation.document import SimulationSpec
from unisim_blender.core.simulation.clock import Exposure
from unisim_blender.core.simulation.drivers import driver_named
from unisim_blender.core.simulation.observations import POINT_FIELDS, EgoMotion, Image, Observation, Sweep
from unisim_blender.core.simulation.rollout.opening import open_scenario
from unisim_blender.core.simulation.rollout.sensors import Sensors, SimulatedSensors, image_of
from unisim_blender.core.simulation.rollout.setup import Simulation
from unisim_blender.core.simulation.step import recorded_ego
from unisim_blender.core.world.captures import SECOND_US, time_name
from unisim_blender.core.world.drive import Actor, Drive

AFTER_S = 0.5
"""Nothing is measured before: tracks are confirmed by three detections."""
POSITION_S, LONGEST_S = 0.5, 5.0
"""Positions of forecasts and plans: so far apart, and up to so long ahead, the paper's end point of plans."""
_STRIDE, _COUNT = round(POSITION_S / STEP_S), round(LONGEST_S / POSITION_S)
_SURFACE_M = 0.05


class RecordedSensors:
    """Delivers the recorded images and sweeps of a log."""

    def __init__(self, log: Log) -> None:
        self.log = log
        self.unsupported: dict[str, float] = {}

    def render(self, drive: Drive, exposures: Sequence[Exposure]) -> tuple[list[Image], list[Sweep]]:
        """See `Sensors.render`."""
        images, sweeps = [], []
        for one in exposures:
            name, frame = one.capture.sensor_id, one.capture.frame
            if frame is None:
                raise UnisimError(f"{self.log.path}: nothing was recorded by {name} at {one.capture.time_us} us")
            if name in drive.cameras:
                images.append(image_of(one, self.log.image(name, frame)))
                continue
            recorded = self.log.sweep(name, frame)
            points = np.zeros(len(recorded.points), POINT_FIELDS)
            pose = drive.lidars[name].world_from_lidar.at(drive.lidars[name].time_s[frame])
            points["x"], points["y"], points["z"] = transform_points(invert_pose(pose), recorded.points).T
            points["intensity"], points["time"] = recorded.intensity, recorded.time_s
            sweeps.append(Sweep(name, one.capture.time_us, one.start_us, one.end_us, points))
        return images, sweeps

    read = render


def outputs_of(simulation: Simulation, sensors: Sensors, detectors: Detectors) -> Outputs:
    """Return what the stack answers to a drive as it was recorded, seen through these sensors."""
    stage, driver = simulation.stage, Perception(simulation.setup(), detectors)
    frames: dict[FrameKey, FrameOutput] = {}
    last_us = stage.start_us
    for now_us in range(stage.start_us, stage.stop_us + 1, stage.step_us):
        ended = stage.ended(last_us, now_us)
        images, sweeps = sensors.render(stage.drive, ended)
        motion = EgoMotion(now_us, recorded_ego(stage, now_us))
        plan = driver.drive(Observation(now_us, tuple(images), tuple(sweeps), (motion,)))
        last_us = now_us
        if now_us < stage.start_us + AFTER_S * SECOND_US:
            continue
        boxes = np.array([track.box for track in driver.tracks]).reshape(-1, 5)
        frames[(stage.drive.name, time_name(now_us))] = FrameOutput(
            boxes,
            np.array([track.score for track in driver.tracks]),
            (CLASS,) * len(boxes),
            np.zeros(len(boxes), bool),
            tuple(_forecast(modes) for modes in driver.forecasts),
            np.stack([plan.x_m, plan.y_m], -1)[_STRIDE :: _STRIDE][:_COUNT],
        )  # fmt: skip
    return Outputs("bev", frames)


def _forecast(modes: Sequence[Mode]) -> Forecast:
    positions = np.stack([mode.boxes[_STRIDE::_STRIDE, :2][:_COUNT] for mode in modes])
    return Forecast(positions, np.array([mode.probability for mode in modes]))


def labels_of(simulation: Simulation, log: Log, like: Outputs) -> Outputs:
    """Return the vehicles that were there, and where they went, for the frames and with the plans of ``like``. A vehicle is
    ignored outside the detectors' region and where the last sweep has few returns of it."""
    stage = simulation.stage
    lidar = next(iter(stage.drive.lidars.values()))
    frames = {}
    for key, answered in like.frames.items():
        now_s = int(str(key[1])[1:-2]) / SECOND_US
        before = max(frame for frame, time_s in lidar.time_s.items() if time_s <= now_s)
        points = log.sweep(lidar.sensor_id, before).points
        ego = invert_pose(stage.drive.world_from_ego.at(now_s))
        boxes, ignored, forecasts = [], [], []
        for actor in stage.drive.actors.values():
            if actor.label not in VEHICLES or not actor.present(now_s):
                continue
            pose = actor.world_from_actor.at(now_s)
            x, y, _ = (ego @ pose)[:3, 3].tolist()
            there = actor.world_from_actor.at(lidar.time_s[before] - lidar.model.sweep_s / 2)
            hits = int(points_in_box(points, there, actor.size_m + 2 * _SURFACE_M).sum())
            yaw = np.arctan2(pose[1, 0], pose[0, 0])
            boxes.append([*pose[:2, 3], *actor.size_m[:2], yaw])
            ignored.append(hits < LEAST_POINTS or not (X_M[0] <= x < X_M[1] and Y_M[0] <= y < Y_M[1]))
            forecasts.append(_went(actor, now_s, stage.stop_us / SECOND_US))
        count = len(boxes)
        frames[key] = FrameOutput(
            np.array(boxes, np.float64).reshape(-1, 5), np.ones(count), (CLASS,) * count, np.array(ignored, bool),
            tuple(forecasts), answered.plan,
        )  # fmt: skip
    return Outputs("bev", frames, False)


def _went(actor: Actor, now_s: float, end_s: float) -> Forecast | None:
    times = [now_s + POSITION_S * (number + 1) for number in range(_COUNT)]
    there = [time_s for time_s in times if time_s <= end_s + 1e-6 and actor.present(time_s)]
    if not there:
        return None
    positions: FloatArray = np.array([actor.world_from_actor.at(time_s)[:2, 3] for time_s in there])
    return Forecast(positions[None], np.ones(1))


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120})
@click.argument("log", type=click.Path(path_type=Path))
@click.argument("weights", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder for documents and metrics.")
@click.option("--renderer", help="As of `unisim render`.  [default: surfel, or the scene's]")
@click.option("--scene", type=click.Path(path_type=Path), help="A trained scene that replays the log.")
@click.option("--quality", default="balanced", show_default=True)
def main(log: Path, weights: Path, out: Path, renderer: str | None, scene: Path | None, quality: str) -> None:
    """The stack of WEIGHTS on LOG as recorded and as replayed."""
    options = RenderOptions(renderer=renderer, scene=scene, quality=quality)
    opened, recorded = open_scenario(log, options), open_log(log)
    simulation = opened.simulation(SimulationSpec(), driver_named("log"), out)
    detectors = Detectors.load(weights)
    replay = SimulatedSensors(simulation.plan, simulation.renderer, None)
    found = {
        "recorded": outputs_of(simulation, RecordedSensors(recorded), detectors),
        "replayed": outputs_of(simulation, replay, detectors),
    }
    labels = labels_of(simulation, recorded, found["recorded"])
    out.mkdir(parents=True, exist_ok=True)
    write_outputs(out / "labels.json", labels)
    metrics: dict[str, Any] = {}
    for name, outputs in found.items():
        write_outputs(out / f"{name}.json", outputs)
        metrics[name] = measure(outputs, labels)
        click.echo(f"{name}: " + "\n".join(table(metrics[name])))
    write_file(out / "metrics.json", (json.dumps(metrics, indent=1) + "\n").encode())


if __name__ == "__main__":
    try:
        main(prog_name="python -m benchmarks.autonomy")
    except UnisimError as error:
        raise SystemExit(f"Error: {error}") from error
