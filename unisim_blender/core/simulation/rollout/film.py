"""A rollout's film: an image and the sweeps from above, side by side, one frame a step."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from ...geometry import FloatArray
from ...output.frame_files import camera_path, lidar_path
from ...output.video import write_video
from ...world.captures import time_of_name
from ..states import EgoState
from ..vehicle.actions import Plan
from ..vehicle.footprint import footprint_of
from .loop import Rollout
from .overhead import Overhead
from .score import footprints_at
from .setup import Simulation
from .steps import Step

FILM_NAME = "film.mp4"
HEIGHT, CAPTION = 360, 28
"""Rows of the pictures and of the line of text below them."""
NOTHING = (40, 40, 40)
"""Where a camera has delivered nothing yet."""


def write_film(simulation: Simulation, rollout: Rollout) -> Path:
    """Write the film of a finished rollout into its folder and return its path: the first camera's latest image, the LiDARs'
    latest returns from above with boxes, the plan and the recorded path, and the vehicle's state in words.

    Raises `OutputError`.
    """
    path = simulation.out / FILM_NAME
    write_video(film_frames(simulation, rollout), path, 1e6 / simulation.stage.step_us)
    return path


def film_frames(simulation: Simulation, rollout: Rollout) -> Iterator[NDArray[np.uint8]]:
    """Yield the film's frames, all of one size (H, W, 3): one for each step, the start included."""
    stage, out = simulation.stage, simulation.out
    cameras, setup = list(stage.drive.cameras), simulation.setup()
    recorded = stage.drive.world_from_ego.positions[:, :2]
    seen = _blank(simulation, cameras)
    returns: dict[str, tuple[tuple[float, float, float], FloatArray]] = {}
    above_m = _above_ground(simulation, rollout.steps[0].ego)
    times = np.array([step.time_us for step in rollout.steps], float)
    for step in rollout.steps:
        for name in step.captures:
            kind, sensor_id, moment = name.split("/")
            if kind == "camera" and sensor_id == cameras[0]:
                seen = _scaled(Image.open(camera_path(out, sensor_id, moment, ".png")).convert("RGB"))
            elif kind == "lidar":
                with np.load(lidar_path(out, sensor_id, moment, ".npz")) as file:
                    points = np.stack([file[axis] for axis in "xyz"], -1).astype(float)
                pose = setup.sensors[sensor_id].rear_axle_from_sensor
                points = points @ pose[:3, :3].T + pose[:3, 3] + (0, 0, above_m)
                returns[sensor_id] = _place_at(rollout, times, time_of_name(moment)), points
        view = Overhead(step.ego, HEIGHT)
        plan = np.stack([step.action.x_m, step.action.y_m], -1) if isinstance(step.action, Plan) else None
        from_above = view.draw(
            _moved(step.ego, list(returns.values())),
            footprints_at(simulation, step),
            footprint_of(step.ego, stage.vehicle),
            plan,
            recorded,
        )
        yield np.concatenate(
            [np.concatenate([seen, from_above], 1), _caption(simulation, step, seen.shape[1] + HEIGHT)]
        )


def _above_ground(simulation: Simulation, ego: EgoState) -> float:
    """Return the height of the rear axle's frame above the ground, 0 where the scene has none there."""
    stage = simulation.stage
    pose = stage.poses_of([ego])[0] @ stage.vehicle.ego_from_axle
    above = float(stage.heights(pose[None, :3, 3])[0])
    return above if np.isfinite(above) else 0.0


def _moved(ego: EgoState, sweeps: list[tuple[tuple[float, float, float], FloatArray]]) -> FloatArray:
    """Return sweeps' points (N, 3) in the rear axle's frame of now, where each was measured from a place (x, y, heading)."""
    if not sweeps:
        return np.zeros((0, 3))
    parts = []
    for (x, y, heading), points in sweeps:
        world = points[:, :2] @ _turn(heading).T + (x, y)
        parts.append(np.column_stack([(world - (ego.x_m, ego.y_m)) @ _turn(ego.heading_rad), points[:, 2]]))
    return np.concatenate(parts)


def _turn(heading: float) -> FloatArray:
    return np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])


def _place_at(rollout: Rollout, times: FloatArray, time_us: float) -> tuple[float, float, float]:
    """Return the rear axle's place and heading at a time, between the steps before and after it."""
    states = [step.ego for step in rollout.steps]
    headings = np.unwrap([state.heading_rad for state in states])
    return (
        float(np.interp(time_us, times, [state.x_m for state in states])),
        float(np.interp(time_us, times, [state.y_m for state in states])),
        float(np.interp(time_us, times, headings)),
    )


def _blank(simulation: Simulation, cameras: list[str]) -> NDArray[np.uint8]:
    """Return what is shown before the first image, of the size of what follows; of no width without cameras."""
    if not cameras:
        return np.zeros((HEIGHT, 0, 3), np.uint8)
    model = simulation.setup().sensors[cameras[0]].model
    return _scaled(Image.new("RGB", (model.width, model.height), NOTHING))  # type: ignore[union-attr]


def _scaled(image: Image.Image) -> NDArray[np.uint8]:
    width = max(2, round(image.width * HEIGHT / image.height / 2) * 2)
    return np.asarray(image.resize((width, HEIGHT), Image.Resampling.LANCZOS))


def _caption(simulation: Simulation, step: Step, width: int) -> NDArray[np.uint8]:
    picture = Image.new("RGB", (width, CAPTION))
    words = [f"{simulation.kind.name}", f"{step.time_us / 1e6:.1f} s", f"{step.ego.speed_m_s:.1f} m/s"]
    if step.unsupported:
        words.append(f"{100 * float(np.mean(list(step.unsupported.values()))):.0f} % unsupported")
    ImageDraw.Draw(picture).text((8, 5), "    ".join(words), fill=(255, 255, 255), font=ImageFont.load_default(15))
    return np.asarray(picture)
