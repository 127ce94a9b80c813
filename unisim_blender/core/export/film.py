"""A finished run, or a log, as one film: cameras, and the LiDARs from above, side by side, with their names and the time; of a
rollout a frame a step, with the driver's plans, and of a log with the actors' boxes in its images.

It is an MP4 file, or where the package imageio-ffmpeg is missing a page (HTML) that plays the film's frames.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from ..data.log import Log
from ..errors import OutputError
from ..files import write_file
from ..formats.rendered import camera_path, lidar_path, read_rendered, sweep_arrays
from ..geometry import FloatArray, box_corners, invert_pose, transform_points
from ..json_file import Node
from ..output.video import playback, write_video
from ..scenario import load_scenario
from ..sensors.silhouettes import bent_edges
from ..simulation.rollout.steps import SCENARIO_NAME, RolloutStep, stream_steps
from ..simulation.states import EgoState, Footprint
from ..simulation.vehicle.actions import Plan
from ..simulation.vehicle.parameters import Vehicle, footprint_of
from ..world.captures import US_PER_SECOND
from ..world.drive import Camera, Drive

WIDTH = 1920
"""Width of the film, in pixels."""
CAPTION = 28
"""Rows of the line of text below the pictures."""
NOTHING = (40, 40, 40)
"""Where a camera has delivered nothing yet."""
SPEED_STEP_S = 0.05
"""Half of the time over which the vehicle's speed is measured."""
GROUND_PERCENTILE = 5.0
"""Percentile of the returns' heights that counts as the ground, for their colours."""
AHEAD_M, BEHIND_M = 50.0, 20.0
"""Distances, metres, shown ahead of the rear axle and behind it; as much across, half to each side."""
LOW_M, HIGH_M = -0.2, 3.0
"""Heights above the ground between which returns change their colour."""
HEIGHT_COLOURS = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], float)
"""From low to high: viridis (van der Walt and Smith, 2015) at even steps."""
BACKGROUND = (16, 16, 20)
RECORDED = (96, 96, 104)
BOX = (230, 230, 230)
EGO_BOX = (255, 140, 40)
PLANNED = (80, 230, 120)


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


class FilmMoment(NamedTuple):
    """A moment's time in seconds, its captures' names in paths by "camera/NAME" and "lidar/NAME", and the step that it is in a
    rollout."""

    time_s: float
    captures: Mapping[str, str]
    step: RolloutStep | None = None


@dataclass(frozen=True)
class FilmSource:
    """What a film shows: a drive with its actors, its title, the ego ``vehicle``, and functions from a sensor's and a
    capture's name to a camera's ``image`` and a LiDAR's ``returns`` (N, 3), world frame."""

    drive: Drive
    title: str
    vehicle: Vehicle
    image: Callable[[str, str], Image.Image]
    returns: Callable[[str, str], FloatArray]


def moments_of(folder: Path, times: Node) -> list[FilmMoment]:
    """Return the steps of a finished rollout that name their captures, else the moments of the manifest's ``times``, in order."""
    steps = [
        FilmMoment(step.time_us / US_PER_SECOND, dict(name.rsplit("/", 1) for name in step.captures), step)
        for step in stream_steps(folder)
    ]
    moments = [
        FilmMoment(node.key("time_s").number(), {sensor: name for sensor, _ in node.members() if sensor != "time_s"})
        for name, node in times.members()
    ]
    return steps if any(step.captures for step in steps) else sorted(moments, key=lambda moment: moment.time_s)


def write_film(
    folder: Path,
    sensors: Sequence[str] | None = None,
    out: Path | None = None,
    on_frame: Callable[[int, int], object] = lambda done, total: None,
    recorded: FloatArray | None = None,
) -> Path:
    """Write the film of a finished sequence or rollout and return its path: ``out``, by default in ``folder``. ``sensors``
    are names in the order in which they are shown; None for all. ``on_frame`` is called with how many of how many frames
    are done. ``recorded`` (N, 2 or 3) is the path that is drawn, world frame; None for that of the vehicle. Raises
    `UnisimError`."""
    manifest, drive = read_rendered(folder)
    moments = moments_of(folder, manifest.key("times"))
    there = {f"camera/{name}": name for name in drive.cameras} | {f"lidar/{name}": name for name in drive.lidars}
    captured = {capture for moment in moments for capture in moment.captures}
    names = {name: sensor for sensor, name in there.items() if sensor in captured}
    for name in sensors or ():
        if name not in names:
            raise OutputError(f'{folder}: has nothing of a sensor "{name}" (there are {", ".join(names)})')
    shown = [names[name] for name in sensors or names]
    moments = [moment for moment in moments if moment.step or not moment.captures.keys().isdisjoint(shown)]
    if not moments or not shown:
        raise OutputError(f"{folder}: holds no images or sweeps for a film")
    path = out or folder / ("film.mp4" if find_spec("imageio_ffmpeg") else "film.html")

    def image(name: str, capture: str) -> Image.Image:
        return _opened(camera_path(folder, name, capture, ".png"))

    def returns(name: str, capture: str) -> FloatArray:
        arrays = sweep_arrays(lidar_path(folder, name, capture, ".npz"))
        return transform_points(
            arrays["world_from_lidar"], np.stack([arrays[axis] for axis in "xyz"], -1).astype(float)
        )

    title, vehicle = drive.name, Vehicle()
    if moments[0].step is not None:
        scenario = load_scenario(folder / SCENARIO_NAME)
        title = scenario.description or title
        vehicle = Vehicle.from_dict((scenario.simulation.vehicle if scenario.simulation else None) or {})
    source = FilmSource(drive, title, vehicle, image, returns)
    _write(source, moments, shown, path, on_frame, recorded)
    return path


def write_log_film(
    log: Log, drive: Drive, out: Path, on_frame: Callable[[int, int], object] = lambda done, total: None
) -> None:
    """Write the film of a log: its recorded images with the boxes of a drive's actors, and its sweeps from above. Raises
    `UnisimError`."""
    cameras, lidars = list(drive.cameras), list(drive.lidars)
    frames = {f"camera/{name}": set(log.image_frames(name)) for name in cameras}
    frames |= {f"lidar/{name}": set(log.sweep_frames(name)) for name in lidars}
    moments = [
        FilmMoment(float(drive.time_s[frame]), {name: str(frame) for name, there in frames.items() if frame in there})
        for frame in drive.frames
    ]
    if not (moments := [moment for moment in moments if moment.captures]):
        raise OutputError(f"{log.path}: holds no images or sweeps for a film")

    def image(name: str, capture: str) -> Image.Image:
        picture = Image.fromarray(log.image(name, int(capture)))
        _draw_boxes(picture, drive, drive.cameras[name], drive.cameras[name].time_s[int(capture)])
        return picture

    source = FilmSource(drive, drive.name, Vehicle(), image, lambda name, capture: log.sweep(name, int(capture)).points)
    _write(source, moments, [name for name in frames if frames[name]], out, on_frame, None)


def _draw_boxes(picture: Image.Image, drive: Drive, camera: Camera, time_s: float) -> None:
    """Draw the boxes of the actors that are present into a camera's image."""
    pen, scale = ImageDraw.Draw(picture), picture.width / camera.model.width
    camera_from_world = invert_pose(camera.world_from_camera.at(time_s))
    for actor in drive.labelled_actors:
        if actor.present(time_s):
            corners = box_corners(actor.world_from_actor.at(time_s), actor.size_m)
            for piece in bent_edges(camera.model, camera_from_world, corners) * scale:
                pen.line(piece.ravel().tolist(), fill=EGO_BOX, width=2)


def _write(
    source: FilmSource, moments: Sequence[FilmMoment], shown: Sequence[str], path: Path,
    on_frame: Callable[[int, int], object], recorded: FloatArray | None,
) -> None:  # fmt: skip
    def frames() -> Iterator[NDArray[np.uint8]]:
        for done, frame in enumerate(film_frames(source, moments, shown, recorded), 1):
            yield frame
            on_frame(done, len(moments))

    times = [moment.time_s for moment in moments]
    rate, counts = playback(times)
    if path.suffix == ".html":
        _write_page(frames(), path, times)
    else:
        write_video((frame for frame, count in zip(frames(), counts, strict=True) for _ in range(count)), path, rate)


def film_frames(
    source: FilmSource, moments: Sequence[FilmMoment], shown: Sequence[str], recorded: FloatArray | None = None
) -> Iterator[NDArray[np.uint8]]:
    """Yield a frame (H, W, 3) for each moment: the newest image of each camera of ``shown``, and the newest returns of
    all its LiDARs from above with the actors' boxes, the plan and a path. Raises `UnisimError`."""
    drive = source.drive
    path = (drive.world_from_ego.positions if recorded is None else recorded)[:, :2]
    cameras, lidars = (
        [sensor.removeprefix(kind) for sensor in shown if sensor.startswith(kind)] for kind in ("camera/", "lidar/")
    )
    columns = math.ceil(math.sqrt(len(cameras)))
    rows = math.ceil(len(cameras) / columns) if cameras else 1
    aspect = max((drive.cameras[name].model.width / drive.cameras[name].model.height for name in cameras), default=0.0)
    high = int(WIDTH / (columns * aspect + (rows if lidars else 0))) // 2 * 2 if cameras else WIDTH // 2
    wide, above = int(high * aspect) // 2 * 2, rows * high if lidars else 0
    canvas = Image.new("RGB", (columns * wide + above, rows * high + CAPTION), NOTHING)
    pen, font = ImageDraw.Draw(canvas), ImageFont.load_default(15)

    def say(x: int, y: int, words: str) -> None:
        pen.text((x + 8, y + 5), words, fill=(255, 255, 255), font=font, stroke_width=2, stroke_fill=(0, 0, 0))

    returns: dict[str, FloatArray] = {}
    for time_s, captures, step in moments:
        for number, name in enumerate(cameras):
            x, y = number % columns * wide, number // columns * high
            if f"camera/{name}" in captures:
                small = _scaled(source.image(name, captures[f"camera/{name}"]), wide, high)
                canvas.paste(small, (x + (wide - small.width) // 2, y + (high - small.height) // 2))
            say(x, y, name)
        for name in lidars:
            if f"lidar/{name}" in captures:
                returns[name] = source.returns(name, captures[f"lidar/{name}"])
        state = step.ego if step else _ego_state(drive, time_s)
        if lidars:
            points = np.concatenate([np.zeros((0, 3)), *returns.values()])
            if len(points):
                points -= (0.0, 0.0, np.percentile(points[:, 2], GROUND_PERCENTILE))
            action = step.action if step else None
            plan = np.stack([action.x_m, action.y_m], -1) if isinstance(action, Plan) else None
            ego, boxes = footprint_of(state, source.vehicle), _boxes(drive, time_s)
            picture = Overhead(state, above).draw(points, boxes, ego, plan, path)
            canvas.paste(Image.fromarray(picture), (columns * wide, 0))
            say(columns * wide, 0, ", ".join(lidars))
        pen.rectangle((0, rows * high, canvas.width, canvas.height), BACKGROUND)
        words = [source.title, f"{time_s:.2f} s", f"{3.6 * state.speed_m_s:.0f} km/h"]
        if step and step.unsupported:
            words.append(f"{100 * float(np.mean(list(step.unsupported.values()))):.0f} % unsupported")
        say(0, rows * high, "    ".join(words))
        yield np.array(canvas)


def _opened(path: Path) -> Image.Image:
    try:
        with Image.open(path) as image:
            return image.convert("RGB")
    except OSError as fault:
        raise OutputError(f"{path}: is missing or no image; a film is made of png files") from fault


def _scaled(image: Image.Image, wide: int, high: int) -> Image.Image:
    """Return an image as large as it fits."""
    scale = min(wide / image.width, high / image.height)
    size = max(1, round(image.width * scale)), max(1, round(image.height * scale))
    return image.resize(size, Image.Resampling.BILINEAR, reducing_gap=2.0)


def _ego_state(drive: Drive, time_s: float) -> EgoState:
    """Return where the middle of the vehicle's rear axle is, and its speed."""
    axle = drive.world_from_ego.at(time_s) @ Vehicle().ego_from_axle
    before, after = drive.world_from_ego.at(time_s + np.array([-SPEED_STEP_S, SPEED_STEP_S]))[:, :3, 3]
    speed_m_s = float(np.linalg.norm(after - before)) / (2 * SPEED_STEP_S)
    return EgoState(float(axle[0, 3]), float(axle[1, 3]), math.atan2(axle[1, 0], axle[0, 0]), speed_m_s)


def _boxes(drive: Drive, time_s: float) -> Iterator[Footprint]:
    """Yield the footprints of the actors that are present."""
    for actor in drive.labelled_actors:
        if actor.present(time_s) and not actor.is_ego_body:
            pose, (length, width, _) = actor.world_from_actor.at(time_s), actor.size_m.tolist()
            heading = math.atan2(pose[1, 0], pose[0, 0])
            yield Footprint(actor.uid, actor.label, pose[0, 3], pose[1, 3], heading, length, width, 0.0)


def _write_page(frames: Iterable[NDArray[np.uint8]], out: Path, times_s: Sequence[float]) -> None:
    """Write frames as JPEG files into the folder of the page's name, and the page that plays them. Raises
    `OutputError`."""
    names = [f"{out.stem}/{number:06d}.jpg" for number in range(len(times_s))]
    for name, frame in zip(names, frames, strict=True):
        buffer = io.BytesIO()
        Image.fromarray(frame).save(buffer, "JPEG", quality=90)
        write_file(out.parent / name, buffer.getvalue())
    page = PLAYER.replace("FRAMES", json.dumps(names)).replace("TIMES", json.dumps(list(times_s)))
    write_file(out, page.encode())


PLAYER = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>UniSim film</title>
<style>body{margin:0;background:#101014}img,input{display:block;width:100%;margin:0}</style>
<img alt="Cameras and LiDARs side by side" title="Click: play or pause"><input type="range" min="0" value="0">
<script>
const frames = FRAMES, times = TIMES, image = document.querySelector("img"), at = document.querySelector("input");
const images = frames.map(name => Object.assign(new Image(), {src: name}));
let start = performance.now(), plays = true;
at.max = frames.length - 1;
at.oninput = () => { plays = false; };
image.onclick = () => { plays = !plays; start = performance.now() - 1000 * (times[at.value] - times[0]); };
setInterval(() => {
  const now = (performance.now() - start) / 1000 + times[0];
  if (plays) at.value = times.filter(time => time <= now).length - 1;
  if (now > times[times.length - 1] + 1) start = performance.now();
  image.src = images[at.value].src;
}, 20);
</script></html>
"""
"""The page: FRAMES are its images' paths, TIMES when they are shown, in seconds."""
