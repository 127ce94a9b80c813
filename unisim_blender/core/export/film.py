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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from ..errors import OutputError
from ..files import write_file
from ..formats.rendered import camera_path, lidar_path, read_rendered, sweep_arrays
from ..geometry import FloatArray, transform_points
from ..output.video import playback, write_video
from ..simulation.rollout.film import BACKGROUND, NOTHING, Overhead
from ..simulation.states import EgoState, Footprint
from ..simulation.vehicle.parameters import Vehicle, footprint_of
from ..world.drive import Drive

FILM, PAGE = "film.mp4", "film.html"
"""Names of the two below a run's folder; a page's frames are in a folder of its name."""
WIDTH, CAPTION = 1920, 28
"""Width of the film, and the height of the line of text below it, in pixels."""
SPEED_STEP_S = 0.05
"""Half of the time over which the vehicle's speed is measured."""
GROUND_PERCENTILE = 5.0
"""Percentile of the returns' heights that counts as the ground, for their colours."""


class FilmMoment(NamedTuple):
    """A moment of a run: its name in paths, its time in seconds, and its captures, "camera/NAME" and "lidar/NAME"."""

    name: str
    time_s: float
    captures: frozenset[str]


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
    every = [
        FilmMoment(name, node.key("time_s").number(), frozenset(sensor for sensor, _ in node.members()))
        for name, node in manifest.key("times").members()
    ]
    there = [*(f"camera/{name}" for name in drive.cameras), *(f"lidar/{name}" for name in drive.lidars)]
    names = {sensor.partition("/")[2]: sensor for sensor in there}
    unknown = [name for name in sensors or () if name not in names]
    if unknown:
        raise OutputError(f'{folder}: has no sensor "{unknown[0]}" (there are {", ".join(names)})')
    shown = [names[name] for name in sensors or names]
    moments = sorted(
        (moment for moment in every if moment.captures.intersection(shown)), key=lambda moment: moment.time_s
    )
    if not moments:
        raise OutputError(f"{folder}: holds no images or sweeps for a film")
    if out is None:
        out = folder / (FILM if find_spec("imageio_ffmpeg") else PAGE)

    def frames() -> Iterator[NDArray[np.uint8]]:
        for done, frame in enumerate(film_frames(folder, drive, moments, shown), 1):
            yield frame
            on_frame(done, len(moments))

    rate, counts = playback([moment.time_s for moment in moments])
    if out.suffix == ".html":
        _write_page(frames(), out, [moment.time_s for moment in moments])
    else:
        write_video((frame for frame, count in zip(frames(), counts, strict=True) for _ in range(count)), out, rate)
    return out


def film_frames(
    folder: Path, drive: Drive, moments: Sequence[FilmMoment], shown: Sequence[str]
) -> Iterator[NDArray[np.uint8]]:
    """Yield a frame (H, W, 3) for each moment: the newest image of each camera of ``shown``, and the newest returns of
    all its LiDARs from above with the actors' boxes. Raises `OutputError`."""
    cameras = [sensor.partition("/")[2] for sensor in shown if sensor.startswith("camera/")]
    lidars = [sensor.partition("/")[2] for sensor in shown if sensor.startswith("lidar/")]
    columns = math.ceil(math.sqrt(len(cameras)))
    rows = math.ceil(len(cameras) / columns) if cameras else 1
    aspect = max((drive.cameras[name].model.width / drive.cameras[name].model.height for name in cameras), default=0.0)
    high = int(WIDTH / (columns * aspect + (rows if lidars else 0))) // 2 * 2 if cameras else WIDTH // 2
    wide, above = int(high * aspect) // 2 * 2, rows * high if lidars else 0
    canvas = Image.new("RGB", (columns * wide + above, rows * high + CAPTION), BACKGROUND)
    pen, font = ImageDraw.Draw(canvas), ImageFont.load_default(15)
    places = {name: (at % columns * wide, at // columns * high) for at, name in enumerate(cameras)}
    for x, y in places.values():
        canvas.paste(NOTHING, (x, y, x + wide, y + high))
    returns: dict[str, FloatArray] = {}
    for moment in moments:
        for name, (x, y) in places.items():
            path = camera_path(folder, name, moment.name, ".png")
            if f"camera/{name}" in moment.captures:
                _paste(canvas, path, (x, y, wide, high))
                _say(pen, (x + 8, y + 6), name, font)
        for name in lidars:
            if f"lidar/{name}" in moment.captures:
                arrays = sweep_arrays(lidar_path(folder, name, moment.name, ".npz"))
                points = np.stack([arrays[axis] for axis in "xyz"], -1).astype(np.float64)
                returns[name] = transform_points(arrays["world_from_lidar"], points)
        state = _ego_state(drive, moment.time_s)
        if lidars:
            picture = _from_above(
                drive, moment.time_s, state, np.concatenate([np.zeros((0, 3)), *returns.values()]), above
            )
            canvas.paste(picture, (columns * wide, 0))
            _say(pen, (columns * wide + 8, 6), ", ".join(lidars), font)
        pen.rectangle((0, rows * high, canvas.width, canvas.height), BACKGROUND)
        words = f"{drive.name}    {moment.time_s:.2f} s    {3.6 * state.speed_m_s:.0f} km/h"
        pen.text((8, rows * high + 5), words, fill=(255, 255, 255), font=font)
        yield np.asarray(canvas).copy()


def _paste(canvas: Image.Image, path: Path, place: tuple[int, int, int, int]) -> None:
    """Put an image into the middle of a rectangle: x, y, width, height."""
    x, y, wide, high = place
    try:
        with Image.open(path) as image:
            scale = min(wide / image.width, high / image.height)
            size = max(1, round(image.width * scale)), max(1, round(image.height * scale))
            small = image.convert("RGB").resize(size, Image.Resampling.BILINEAR, reducing_gap=2.0)
    except OSError as fault:
        raise OutputError(f"{path}: is missing or no image; a film is made of png files") from fault
    canvas.paste(small, (x + (wide - size[0]) // 2, y + (high - size[1]) // 2))


def _say(
    pen: ImageDraw.ImageDraw, place: tuple[int, int], words: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont
) -> None:
    """Write a name that can be read on any image."""
    pen.text(place, words, fill=(255, 255, 255), font=font, stroke_width=2, stroke_fill=(0, 0, 0))


def _ego_state(drive: Drive, time_s: float) -> EgoState:
    """Return where the middle of the vehicle's rear axle is, and its speed."""
    axle = drive.world_from_ego.at(time_s) @ Vehicle().ego_from_axle
    before, after = drive.world_from_ego.at(time_s + np.array([-SPEED_STEP_S, SPEED_STEP_S]))[:, :3, 3]
    speed_m_s = float(np.linalg.norm(after - before)) / (2 * SPEED_STEP_S)
    return EgoState(float(axle[0, 3]), float(axle[1, 3]), math.atan2(axle[1, 0], axle[0, 0]), speed_m_s)


def _from_above(drive: Drive, time_s: float, state: EgoState, returns: FloatArray, pixels: int) -> Image.Image:
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
    return Image.fromarray(Overhead(state, pixels).draw(returns, boxes, footprint_of(state, Vehicle()), None, path))


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
<style>body{margin:0;background:#101014;color:#fff;font:15px sans-serif}img{display:block;width:100%}
p{display:flex;gap:12px;margin:10px}input{flex:1}</style>
<img id="image" alt="Cameras and LiDARs side by side">
<p><button id="play">Pause</button><input id="at" type="range" min="0" value="0"><span id="time"></span></p>
<script>
const frames = FRAMES, times = TIMES, image = document.getElementById("image"), at = document.getElementById("at");
const play = document.getElementById("play"), images = frames.map(name => { const i = new Image(); i.src = name; return i; });
at.max = frames.length - 1;
let runs = true, began = performance.now() - 1000 * times[0];
function show(n) {
  image.src = images[n].src; at.value = n;
  document.getElementById("time").textContent = times[n].toFixed(2) + " s";
}
function from(n) { began = performance.now() - 1000 * times[n]; }
function tick(now) {
  let n = +at.value;
  while (runs && n < frames.length - 1 && times[n + 1] <= (now - began) / 1000) n++;
  if (n != +at.value) show(n);
  if (runs && n == frames.length - 1 && (now - began) / 1000 > times[n] + 1) { show(0); from(0); }
  requestAnimationFrame(tick);
}
at.oninput = () => { show(+at.value); from(+at.value); };
play.onclick = () => { runs = !runs; play.textContent = runs ? "Pause" : "Play"; from(+at.value); };
show(0); requestAnimationFrame(tick);
</script></html>
"""
"""The page: FRAMES are its images' paths, TIMES when they are shown, in seconds."""
