"""A finished run as one film: cameras, and the LiDARs from above, side by side, with their names and the time.

It is an MP4 file, or where the package imageio-ffmpeg is missing a page (HTML) that plays the film's frames.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from ..errors import OutputError
from ..files import write_file
from ..formats.rendered import camera_path, lidar_path, read_rendered, sweep_arrays
from ..geometry import FloatArray, transform_points
from ..output.video import playback, write_video
from ..simulation.rollout.film import BACKGROUND, CAPTION, NOTHING, Overhead
from ..simulation.states import EgoState, Footprint
from ..simulation.vehicle.parameters import Vehicle, footprint_of
from ..world.drive import Drive

WIDTH = 1920
"""Width of the film, in pixels."""
SPEED_STEP_S = 0.05
"""Half of the time over which the vehicle's speed is measured."""
GROUND_PERCENTILE = 5.0
"""Percentile of the returns' heights that counts as the ground, for their colours."""
FilmMoment = tuple[float, str, frozenset[str]]
"""A moment's time in seconds, its name in paths, and its captures, "camera/NAME" and "lidar/NAME"."""


def write_film(
    folder: Path,
    sensors: Sequence[str] | None = None,
    out: Path | None = None,
    on_frame: Callable[[int, int], object] = lambda done, total: None,
) -> Path:
    """Write the film of a finished sequence or rollout and return its path: ``out``, by default in ``folder``. ``sensors``
    are names in the order in which they are shown; None for all. ``on_frame`` is called with how many of how many frames
    are done. Raises `UnisimError`."""
    manifest, drive = read_rendered(folder)
    moments: list[FilmMoment] = sorted(
        (node.key("time_s").number(), name, frozenset(sensor for sensor, _ in node.members()) - {"time_s"})
        for name, node in manifest.key("times").members()
    )
    there = {f"camera/{name}": name for name in drive.cameras} | {f"lidar/{name}": name for name in drive.lidars}
    captured = frozenset[str]().union(*(captures for _, _, captures in moments))
    names = {name: sensor for sensor, name in there.items() if sensor in captured}
    for name in sensors or ():
        if name not in names:
            raise OutputError(f'{folder}: has nothing of a sensor "{name}" (there are {", ".join(names)})')
    shown = [names[name] for name in sensors or names]
    moments = [moment for moment in moments if moment[2].intersection(shown)]
    if not moments:
        raise OutputError(f"{folder}: holds no images or sweeps for a film")
    path = out or folder / ("film.mp4" if find_spec("imageio_ffmpeg") else "film.html")

    def frames() -> Iterator[NDArray[np.uint8]]:
        for done, frame in enumerate(film_frames(folder, drive, moments, shown), 1):
            yield frame
            on_frame(done, len(moments))

    times = [time_s for time_s, _, _ in moments]
    rate, counts = playback(times)
    if path.suffix == ".html":
        _write_page(frames(), path, times)
    else:
        write_video((frame for frame, count in zip(frames(), counts, strict=True) for _ in range(count)), path, rate)
    return path


def film_frames(
    folder: Path, drive: Drive, moments: Sequence[FilmMoment], shown: Sequence[str]
) -> Iterator[NDArray[np.uint8]]:
    """Yield a frame (H, W, 3) for each moment: the newest image of each camera of ``shown``, and the newest returns of
    all its LiDARs from above with the actors' boxes. Raises `OutputError`."""
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
    for time_s, moment, captures in moments:
        for number, name in enumerate(cameras):
            x, y = number % columns * wide, number // columns * high
            if f"camera/{name}" in captures:
                small = _scaled(camera_path(folder, name, moment, ".png"), wide, high)
                canvas.paste(small, (x + (wide - small.width) // 2, y + (high - small.height) // 2))
            say(x, y, name)
        for name in lidars:
            if f"lidar/{name}" in captures:
                arrays = sweep_arrays(lidar_path(folder, name, moment, ".npz"))
                points = np.stack([arrays[axis] for axis in "xyz"], -1).astype(np.float64)
                returns[name] = transform_points(arrays["world_from_lidar"], points)
        state = _ego_state(drive, time_s)
        if lidars:
            points = np.concatenate([np.zeros((0, 3)), *returns.values()])
            canvas.paste(Image.fromarray(_from_above(drive, time_s, state, points, above)), (columns * wide, 0))
            say(columns * wide, 0, ", ".join(lidars))
        pen.rectangle((0, rows * high, canvas.width, canvas.height), BACKGROUND)
        say(0, rows * high, f"{drive.name}    {time_s:.2f} s    {3.6 * state.speed_m_s:.0f} km/h")
        yield np.array(canvas)


def _scaled(path: Path, wide: int, high: int) -> Image.Image:
    """Return an image as large as it fits."""
    try:
        with Image.open(path) as image:
            scale = min(wide / image.width, high / image.height)
            size = max(1, round(image.width * scale)), max(1, round(image.height * scale))
            return image.convert("RGB").resize(size, Image.Resampling.BILINEAR, reducing_gap=2.0)
    except OSError as fault:
        raise OutputError(f"{path}: is missing or no image; a film is made of png files") from fault


def _ego_state(drive: Drive, time_s: float) -> EgoState:
    """Return where the middle of the vehicle's rear axle is, and its speed."""
    axle = drive.world_from_ego.at(time_s) @ Vehicle().ego_from_axle
    before, after = drive.world_from_ego.at(time_s + np.array([-SPEED_STEP_S, SPEED_STEP_S]))[:, :3, 3]
    speed_m_s = float(np.linalg.norm(after - before)) / (2 * SPEED_STEP_S)
    return EgoState(float(axle[0, 3]), float(axle[1, 3]), math.atan2(axle[1, 0], axle[0, 0]), speed_m_s)


def _from_above(drive: Drive, time_s: float, state: EgoState, returns: FloatArray, pixels: int) -> NDArray[np.uint8]:
    """Return the picture from above: returns (N, 3), world frame, the actors' boxes, the vehicle and its path."""
    if len(returns):
        returns = returns - (0.0, 0.0, np.percentile(returns[:, 2], GROUND_PERCENTILE))
    boxes = []
    for actor in drive.labelled_actors:
        if actor.present(time_s) and not actor.is_ego_body:
            pose, (length, width, _) = actor.world_from_actor.at(time_s), actor.size_m.tolist()
            heading = math.atan2(pose[1, 0], pose[0, 0])
            boxes.append(Footprint(actor.uid, actor.label, pose[0, 3], pose[1, 3], heading, length, width, 0.0))
    path = drive.world_from_ego.positions[:, :2]
    return Overhead(state, pixels).draw(returns, boxes, footprint_of(state, Vehicle()), None, path)


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
