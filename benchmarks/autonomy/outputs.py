"""What the stack answers to a drive, and what was truly there, as documents that `unisim metrics` reads.

Open loop: the vehicle is where the drive has it, and the stack sees one frame after another.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.detection.samples import LEAST_POINTS, VEHICLES, X_M, Y_M
from benchmarks.detection.testing import CLASS
from examples.perception.candidates import STEP_S
from examples.perception.driver import Perception
from examples.perception.objects import Mode
from examples.perception.sensing import Detectors
from unisim_blender.core.data.log import Log
from unisim_blender.core.evaluation.autonomy.document import Forecast, FrameKey, FrameOutput, ModelOutputs
from unisim_blender.core.geometry import FloatArray, invert_pose, points_in_box
from unisim_blender.core.simulation.drivers.driver import EgoMotion, Observation
from unisim_blender.core.simulation.rollout.sensors import SensorSource
from unisim_blender.core.simulation.rollout.setup import Simulation
from unisim_blender.core.simulation.step import recorded_ego
from unisim_blender.core.world.captures import US_PER_SECOND, time_name
from unisim_blender.core.world.drive import Actor

AFTER_S = 0.5
"""Nothing is measured before: tracks are confirmed by three detections."""
POSITION_S, LONGEST_S = 0.5, 5.0
"""Positions of forecasts and plans: so far apart, and up to so long ahead, the paper's end point of plans."""
_STRIDE, _COUNT = round(POSITION_S / STEP_S), round(LONGEST_S / POSITION_S)
_SURFACE_M = 0.05


def outputs_of(simulation: Simulation, sensors: SensorSource, detectors: Detectors) -> ModelOutputs:
    """Return what the stack answers to a drive as it was recorded, seen through these sensors."""
    context, driver = simulation.context, Perception(simulation.setup(), detectors)
    frames: dict[FrameKey, FrameOutput] = {}
    last_us = context.start_us
    for now_us in range(context.start_us, context.stop_us + 1, context.step_us):
        ended = context.ended(last_us, now_us)
        images, sweeps = sensors.render(context.drive, ended)
        motion = EgoMotion(now_us, recorded_ego(context, now_us))
        plan = driver.drive(Observation(now_us, tuple(images), tuple(sweeps), (motion,)))
        last_us = now_us
        if now_us < context.start_us + AFTER_S * US_PER_SECOND:
            continue
        boxes = np.array([track.box for track in driver.tracks]).reshape(-1, 5)
        frames[(context.drive.name, time_name(now_us))] = FrameOutput(
            boxes,
            np.array([track.score for track in driver.tracks]),
            (CLASS,) * len(boxes),
            np.zeros(len(boxes), bool),
            tuple(_forecast(modes) for modes in driver.forecasts),
            np.stack([plan.x_m, plan.y_m], -1)[_STRIDE :: _STRIDE][:_COUNT],
        )  # fmt: skip
    return ModelOutputs("bev", frames)


def _forecast(modes: Sequence[Mode]) -> Forecast:
    positions = np.stack([mode.boxes[_STRIDE::_STRIDE, :2][:_COUNT] for mode in modes])
    return Forecast(positions, np.array([mode.probability for mode in modes]))


def labels_of(simulation: Simulation, log: Log, like: ModelOutputs) -> ModelOutputs:
    """Return the vehicles that were there, and where they went, for the frames and with the plans of ``like``. A vehicle is
    ignored outside the detectors' region and where the last sweep has few returns of it."""
    context = simulation.context
    lidar = next(iter(context.drive.lidars.values()))
    swept = log.sweep_frames(lidar.sensor_id)
    frames = {}
    for key, answered in like.frames.items():
        now_s = int(str(key[1])[1:-2]) / US_PER_SECOND
        before = max((frame for frame in swept if lidar.time_s[frame] <= now_s), default=swept[0])
        points = log.sweep(lidar.sensor_id, before).points
        ego = invert_pose(context.drive.world_from_ego.at(now_s))
        boxes, ignored, forecasts = [], [], []
        for actor in context.drive.actors.values():
            if actor.label not in VEHICLES or not actor.present(now_s):
                continue
            pose = actor.world_from_actor.at(now_s)
            x, y, _ = (ego @ pose)[:3, 3].tolist()
            there = actor.world_from_actor.at(lidar.time_s[before] - lidar.model.sweep_s / 2)
            hits = int(points_in_box(points, there, actor.size_m + 2 * _SURFACE_M).sum())
            yaw = np.arctan2(pose[1, 0], pose[0, 0])
            boxes.append([*pose[:2, 3], *actor.size_m[:2], yaw])
            ignored.append(hits < LEAST_POINTS or not (X_M[0] <= x < X_M[1] and Y_M[0] <= y < Y_M[1]))
            forecasts.append(_went(actor, now_s, context.stop_us / US_PER_SECOND))
        count = len(boxes)
        frames[key] = FrameOutput(
            np.array(boxes, np.float64).reshape(-1, 5), np.ones(count), (CLASS,) * count, np.array(ignored, bool),
            tuple(forecasts), answered.plan,
        )  # fmt: skip
    return ModelOutputs("bev", frames, False)


def _went(actor: Actor, now_s: float, end_s: float) -> Forecast | None:
    times = [now_s + POSITION_S * (number + 1) for number in range(_COUNT)]
    there = [time_s for time_s in times if time_s <= end_s + 1e-6 and actor.present(time_s)]
    if not there:
        return None
    positions: FloatArray = np.array([actor.world_from_actor.at(time_s)[:2, 3] for time_s in there])
    return Forecast(positions[None], np.ones(1))
