"""A rollout's film: an image and the sweeps from above, side by side, one frame a step."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from ...formats.rendered import camera_path, lidar_path
from ...geometry import FloatArray, make_pose, quaternion_from_yaw, transform_points
from ...output.video import write_video
from ...world.captures import time_of_name
from ..drivers.driver import DriverSetup
from ..states import EgoState, Footprint
from ..vehicle.actions import Plan
from ..vehicle.parameters import footprint_of
from .loop import Rollout
from .score import footprints_at
from .setup import Simulation
from .steps import RolloutStep

AHEAD_M, BEHIND_M = 50.0, 20.0
"""Distances, metres, shown ahead of the rear axle and behind it; as much across, half to each side."""
LOW_M, HIGH_M = -0.2, 3.0
"""Heights above the ground between which returns change their colour."""
HEIGHT_COLOURS = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], float)
"""From low to high: viridis (van der Walt and Smith, 2015) at even steps."""
BACKGROUND, RECORDED, BOX, EGO_BOX, PLANNED = (
    (16, 16, 20),
    (96, 96, 104),
    (230, 230, 230),
    (255, 140, 40),
    (80, 230, 120),
)


@dataclass(frozen=True)
class Overhead:
    """The square picture of ``pixels`` by ``pixels`` about an ego vehicle's ``state``, which drives upwards."""

    state: EgoState
    pixels: int

    def place(self, points: FloatArray) -> FloatArray:
        """Return the pixels (N, 2), column and row, of points (N, 2), world frame."""
        sine, cosine = math.sin(self.state.heading_rad), math.cos(self.state.heading_rad)
        offset = np.asarray(points, float) - (self.state.x_m, self.state.y_m)
        scale = self.pixels / (AHEAD_M + BEHIND_M)
        column = self.pixels / 2 - offset @ (-sine, cosine) * scale
        return np.stack([column, (AHEAD_M - offset @ (cosine, sine)) * scale], -1)

    def draw(
        self,
        returns: FloatArray,
        footprints: Iterable[Footprint],
        ego: Footprint,
        plan: FloatArray | None,
        recorded: FloatArray,
    ) -> NDArray[np.uint8]:
        """Return the picture (pixels, pixels, 3).

        ``returns`` (N, 3) are their places in the world's plane and their heights above the ground; ``plan`` (P, 2) and
        ``recorded`` (R, 2) are paths, world frame.
        """
        canvas = np.full((self.pixels, self.pixels, 3), BACKGROUND, np.uint8)
        at = np.floor(self.place(returns[:, :2])).astype(int)
        shown = ((at >= 0) & (at < self.pixels)).all(1)
        order = np.argsort(returns[shown, 2], kind="stable")  # what is higher hides what is lower
        at, heights = at[shown][order], returns[shown, 2][order]
        canvas[at[:, 1], at[:, 0]] = colours_of(heights)
        picture = Image.fromarray(canvas)
        pen = ImageDraw.Draw(picture)
        self._line(pen, recorded, RECORDED, 1)
        for footprint in footprints:
            self._outline(pen, footprint, BOX)
        if plan is not None:
            self._line(pen, plan, PLANNED, 2)
        self._outline(pen, ego, EGO_BOX)
        return np.asarray(picture)

    def _outline(self, pen: ImageDraw.ImageDraw, box: Footprint, colour: tuple[int, int, int]) -> None:
        corners = self.place(box.corners)
        pen.polygon([tuple(corner) for corner in corners], outline=colour)
        front, centre = corners[[0, 3]].mean(0), corners.mean(0)
        pen.line([tuple(centre), tuple(front)], fill=colour)

    def _line(self, pen: ImageDraw.ImageDraw, points: FloatArray, colour: tuple[int, int, int], width: int) -> None:
        if len(points) > 1:
            pen.line([tuple(place) for place in self.place(points)], fill=colour, width=width)


def colours_of(heights_m: FloatArray) -> NDArray[np.uint8]:
    """Return colours (N, 3) of heights (N,) above the ground."""
    share = np.clip((heights_m - LOW_M) / (HIGH_M - LOW_M), 0, 1) * (len(HEIGHT_COLOURS) - 1)
    steps = np.arange(len(HEIGHT_COLOURS))
    return np.stack([np.interp(share, steps, channel) for channel in HEIGHT_COLOURS.T], -1).astype(np.uint8)


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
    write_video(film_frames(simulation, rollout), path, 1e6 / simulation.context.step_us)
    return path


def film_frames(simulation: Simulation, rollout: Rollout) -> Iterator[NDArray[np.uint8]]:
    """Yield the film's frames, all of one size (H, W, 3): one for each step, the start included."""
    context, out, setup = simulation.context, simulation.out, simulation.setup()
    cameras = list(context.drive.cameras)
    recorded = context.drive.world_from_ego.positions[:, :2]
    seen = _blank(setup, cameras)
    returns: dict[str, FloatArray] = {}
    times, places = _path(rollout)
    for step in rollout.steps:
        for name in step.captures:
            kind, sensor_id, moment = name.split("/")
            if kind == "camera" and sensor_id == cameras[0]:
                seen = _scaled(Image.open(camera_path(out, sensor_id, moment, ".png")).convert("RGB"))
            elif kind == "lidar":
                with np.load(lidar_path(out, sensor_id, moment, ".npz")) as file:
                    points = np.stack([file[axis] for axis in "xyz"], -1).astype(float)
                x, y, heading = (np.interp(time_of_name(moment), times, column) for column in places.T)
                ground_from_axle = make_pose(np.array([x, y, setup.rear_axle_height_m]), quaternion_from_yaw(heading))
                returns[sensor_id] = transform_points(
                    ground_from_axle @ setup.sensors[sensor_id].rear_axle_from_sensor, points
                )
        plan = np.stack([step.action.x_m, step.action.y_m], -1) if isinstance(step.action, Plan) else None
        from_above = Overhead(step.ego, HEIGHT).draw(
            np.concatenate([np.zeros((0, 3)), *returns.values()]),
            footprints_at(simulation, step),
            footprint_of(step.ego, context.vehicle),
            plan,
            recorded,
        )
        yield np.concatenate(
            [np.concatenate([seen, from_above], 1), _caption(simulation, step, seen.shape[1] + HEIGHT)]
        )


def _path(rollout: Rollout) -> tuple[FloatArray, FloatArray]:
    """Return the steps' times (T,) in microseconds, and the rear axle's x, y and heading, without jumps of a turn, (T, 3)."""
    states = [step.ego for step in rollout.steps]
    headings = np.unwrap([state.heading_rad for state in states])
    places = np.array([(state.x_m, state.y_m) for state in states])
    return np.array([step.time_us for step in rollout.steps], float), np.column_stack([places, headings])


def _blank(setup: DriverSetup, cameras: list[str]) -> NDArray[np.uint8]:
    """Return what is shown before the first image, of the size of what follows; of no width without cameras."""
    if not cameras:
        return np.zeros((HEIGHT, 0, 3), np.uint8)
    model = setup.sensors[cameras[0]].model
    return _scaled(Image.new("RGB", (model.width, model.height), NOTHING))  # type: ignore[union-attr]


def _scaled(image: Image.Image) -> NDArray[np.uint8]:
    width = max(2, round(image.width * HEIGHT / image.height / 2) * 2)
    return np.asarray(image.resize((width, HEIGHT), Image.Resampling.LANCZOS))


def _caption(simulation: Simulation, step: RolloutStep, width: int) -> NDArray[np.uint8]:
    picture = Image.new("RGB", (width, CAPTION))
    words = [f"{simulation.kind.name}", f"{step.time_us / 1e6:.1f} s", f"{step.ego.speed_m_s:.1f} m/s"]
    if step.unsupported:
        words.append(f"{100 * float(np.mean(list(step.unsupported.values()))):.0f} % unsupported")
    ImageDraw.Draw(picture).text((8, 5), "    ".join(words), fill=(255, 255, 255), font=ImageFont.load_default(15))
    return np.asarray(picture)
