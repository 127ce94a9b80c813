"""Lamps that a log shows in two states: texels of actors' boxes whose colours jump between two values together.

Each image that shows a face of an actor's box gives its texels their colours, less what changes the whole face: exposure,
shade. Texels between whose two levels there is nothing, and which change at the same times, are a lamp where they are small,
red, amber or green when lit, and lit in neighbouring images. White ones are not told from reflections.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb
from ..data.log import Log, cached_file
from ..errors import LogError, UnisimError
from ..files import write_cached
from ..geometry import BoolArray, FloatArray, bilinear, box_sums, invert_pose, transform_points
from ..json_file import Node, read_json
from ..sensors.camera import line_times, lines
from ..world.classes import motion_of
from ..world.drive import Actor, Camera
from ..world.lamps import ActorLamp, LampPatch
from .best_views import actors_in_images

VERSION = 1
"""Version of the cache, raised when the same log gives other lamps."""
TEXELS, LEAST_TEXEL_M = 96, 0.02
"""Number of texels along a face's longer edge, and the smallest edge of a texel, metres."""
LEAST_PX_PER_M, LEAST_COSINE = 15.0, 0.35
"""Pixels per metre of a face at which it is looked at, and cosine between its normal and the line of sight."""
LEAST_IMAGES = 8
"""Smallest number of images of a face from which lamps are recognised."""
LEAST_CONTRAST, LEAST_GAP, LEAST_GROUP_GAP = 0.15, 3.5, 4.5
"""Least difference of sRGB between two levels, and how many standard deviations these are apart, of a texel and of a lamp. A
drift without levels has 3.5."""
AGREE = 0.9
"""Part of the images in which texels of a lamp are in the same state, or in opposite ones."""
BLUR_M, MOST_GAIN = 0.25, 1.0
"""Distance, metres, within which exposure and shade change all texels, and the logarithm of the largest such change."""
LEAST_AREA_PX, MOST_AREA = 4.0, 0.4
"""A lamp's area: pixels in the image that shows it largest, and part of the faces that it is on."""
RIM, RIM_TEXELS = 0.2, 2
"""Part of a lamp's change that texels beside it show which belong to it, and how far beside."""
LEAST_SOLID = 0.3
"""Part of a lamp's texels that others surround: edges and specks that change are none."""
MOST_OF_REST = 0.4
"""Change of the face's rest (90 % of it) beside the lamp's: where all changes, it is light, or the box is not where it was."""
LEAST_STEADY = 5.0
"""Difference of a lamp's two colours beside how much each varies between images: what is behind a box's corner varies more."""
LEAST_LIT, LEAST_MORE, LEAST_COLOURED = 0.5, 1.4, 0.06
"""Of a lit lamp's texel: sRGB of its brighter channel, how many times the light of an unlit one it gives, and how much more
coloured its sRGB is."""
SIDE = 0.15
"""Part of the box's width from its middle from which on a lamp is left or right."""


@dataclass
class _Face:
    """A face of an actor's box and its samples: colours (H, W, 3), NaN where covered, by image."""

    axis: int
    side: int
    low: FloatArray
    shape: tuple[int, int]
    texel_m: float
    points: FloatArray
    samples: dict[int, NDArray[np.float32]]


def lamps_in(log: Log, progress: Callable[[float], object] = lambda share: None) -> dict[str, tuple[ActorLamp, ...]]:
    """Return the lamps of a log's actors that it shows in two states, by their ids; from the cache where it was searched before.

    ``progress`` is called with fractions from 0 to 1. Raises `LogError` where an image cannot be read.
    """
    cached = cached_file(log, "lamps", f"{VERSION}.json")
    if cached.is_file():
        try:
            return {
                uid: tuple(map(ActorLamp.from_json, lamps.elements()))
                for uid, lamps in Node(read_json(cached, LogError), f"{cached}: ", LogError).members()
            }
        except UnisimError:
            pass  # a broken one is made anew
    lamps = dict(_search(log, progress))
    document = {uid: [lamp.to_json() for lamp in some] for uid, some in lamps.items()}
    write_cached(cached, json.dumps(document).encode())
    return lamps


def _search(log: Log, progress: Callable[[float], object]) -> Iterator[tuple[str, tuple[ActorLamp, ...]]]:
    actors = [actor for actor in log.drive.actors.values() if motion_of(actor.label) != "deforming"]
    faces = [_faces_of(actor) for actor in actors]
    times: list[float] = []
    sizes: list[dict[int, float]] = [{} for _ in actors]
    total = sum(len(log.image_frames(name)) for name in log.drive.cameras)
    for name, camera in log.drive.cameras.items():
        frames = tuple(frame for frame in log.image_frames(name) if frame in camera.time_s)
        views = actors_in_images(actors, camera, frames)
        for column, frame in enumerate(frames):
            image = None
            for number in np.flatnonzero(views.there[:, column]):
                near = views.there[:, column] & (views.depth_m[:, column] < views.depth_m[number, column] - 0.1)
                seen = _visible(actors[number], faces[number], camera, camera.time_s[frame])
                for face, u, v, px_per_m in seen:
                    image = log.image(name, frame) if image is None else image
                    colours = _sampled(image, u, v)
                    for left, top, right, bottom in views.cut[near, column]:
                        colours[(u > left) & (u < right) & (v > top) & (v < bottom)] = np.nan
                    face.samples[len(times)] = colours
                    sizes[number][len(times)] = px_per_m
            times.append(camera.time_s[frame])
            progress(len(times) / total)
    for actor, own, size in zip(actors, faces, sizes, strict=True):
        if lamps := lamps_of_faces(actor.size_m, own, np.array(times), size):
            yield actor.uid, lamps


def _faces_of(actor: Actor) -> list[_Face]:
    faces = []
    for axis, side in ((0, 1), (0, -1), (1, 1), (1, -1)):
        extent = np.delete(actor.size_m, axis)
        texel = max(float(extent.max()) / TEXELS, LEAST_TEXEL_M)
        shape = int(np.ceil(extent[0] / texel)), int(np.ceil(extent[1] / texel))
        low = -np.array(shape) * texel / 2
        at = [low[k] + (np.arange(shape[k]) + 0.5) * texel for k in range(2)]
        grid = np.stack(np.meshgrid(*at, indexing="ij"), -1)
        points = np.insert(grid, axis, side * actor.size_m[axis] / 2, -1)
        faces.append(_Face(axis, side, low, shape, texel, points, {}))
    return faces


def _visible(
    actor: Actor, faces: list[_Face], camera: Camera, time_s: float
) -> Iterator[tuple[_Face, FloatArray, FloatArray, float]]:
    """Yield the faces that a camera sees in an image, where their texels are in it (H, W), and its pixels per metre there."""
    for face in faces:
        middle = np.zeros(3)
        middle[face.axis] = face.side * actor.size_m[face.axis] / 2
        moment = time_s
        for _ in range(2):  # once more at the time of the line that shows it
            camera_from_actor = invert_pose(camera.world_from_camera.at(moment)) @ actor.world_from_actor.at(moment)
            seen = transform_points(camera_from_actor, middle[None])[0]
            if seen[2] < 1.0:
                break
            u, v, _ = camera.model.project(seen)
            moment = float(line_times(camera, time_s, lines(camera.model, u, v)))
        distance = float(np.linalg.norm(seen))
        cosine = -float(camera_from_actor[:3, face.axis] @ seen) * face.side / distance
        px_per_m = camera.model.pixels_per_rad / distance
        if seen[2] < 1.0 or not cosine > LEAST_COSINE or px_per_m < LEAST_PX_PER_M:
            continue
        u, v, valid = camera.model.project(transform_points(camera_from_actor, face.points.reshape(-1, 3)))
        valid &= (u > 1) & (u < camera.model.width - 1) & (v > 1) & (v < camera.model.height - 1)
        if valid.mean() > 0.95:
            yield face, u.reshape(face.shape), v.reshape(face.shape), px_per_m


def _sampled(image: NDArray[np.uint8], u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
    """Return colours (..., 3), 0 to 1, of an image (H, W, 3) at u, v (...), bilinear; NaN outside."""
    out = bilinear(image, *(np.nan_to_num(x.reshape(-1)) for x in (u, v))).reshape(*u.shape, 3) / np.float32(255)
    out[~((u >= 0) & (u <= image.shape[1]) & (v >= 0) & (v <= image.shape[0]))] = np.nan
    return out


def lamps_of_faces(
    size_m: FloatArray, faces: list[_Face], times_s: FloatArray, px_per_m: dict[int, float]
) -> tuple[ActorLamp, ...]:
    """Return the lamps on the faces of a box of ``size_m`` (3,): their samples by image, images at ``times_s`` (I,) and with
    ``px_per_m``."""
    faces = [face for face in faces if len(face.samples) >= LEAST_IMAGES]
    images = np.array(sorted({image for face in faces for image in face.samples}, key=lambda image: times_s[image]))
    if not faces:
        return ()
    recorded, colours = np.concatenate([_colours(face, images) for face in faces], 2)
    texels = np.concatenate([[number] * (face.shape[0] * face.shape[1]) for number, face in enumerate(faces)])
    levels = _brightness(colours)
    low, high, spread = _two_levels(levels)
    candidates = np.flatnonzero((high - low > LEAST_CONTRAST) & (high - low > LEAST_GAP * spread))
    with np.errstate(invalid="ignore"):
        states = np.where(
            np.isnan(levels[:, candidates]), np.nan, levels[:, candidates] > ((low + high) / 2)[candidates]
        )
    size = np.array([px_per_m[image] for image in images])
    lamps: list[ActorLamp] = []
    while len(candidates):
        seed = int((high - low)[candidates].argmax())
        both = ~np.isnan(states) & ~np.isnan(states[:, [seed]])
        agree = ((states == states[:, [seed]]) & both).sum(0) / np.maximum(both.sum(0), 1)
        same, opposite = agree >= AGREE, agree <= 1 - AGREE
        same[seed] = True
        changing = candidates[same], candidates[opposite]
        lamp = _lamp(size_m, faces, texels, recorded, colours, *changing, times_s[images], size)
        if lamp is not None and all(lamp.name != other.name for other in lamps):
            lamps.append(lamp)
        candidates, states = candidates[~(same | opposite)], states[:, ~(same | opposite)]
    return tuple(lamps)


def _colours(face: _Face, images: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return the colours (2, I, N, 3) of a face's texels by image, NaN where it is not seen: as recorded, and less what changes
    all around them."""
    colours = np.full((2, len(images), face.shape[0] * face.shape[1], 3), np.nan, np.float32)
    rows = np.flatnonzero(np.isin(images, list(face.samples)))
    seen = np.stack([face.samples[int(image)] for image in images[rows]])
    bright = seen.mean(3)
    usual = _medians(bright.reshape(len(rows), -1)).reshape(face.shape)
    change = np.log(np.maximum(bright, 0.03) / np.maximum(usual, 0.03)).clip(-MOST_GAIN, MOST_GAIN)
    known, reach = ~np.isnan(change), round(BLUR_M / face.texel_m)
    gains = np.exp(box_sums(np.nan_to_num(change), reach) / np.maximum(box_sums(known, reach), 1))
    colours[:, rows] = np.stack([seen, seen / gains[..., None]]).reshape(2, len(rows), -1, 3)
    return colours


def _medians(values: NDArray[Any]) -> FloatArray:
    """Return the medians (N,) of series (T, N), NaN left out; 1 where nothing is left."""
    ordered, count = np.sort(values, 0), (~np.isnan(values)).sum(0)
    middle = ordered[np.maximum(count - 1, 0) // 2, np.arange(values.shape[1])]
    return np.asarray(np.where(count > 0, middle, 1.0), np.float64)


def _brightness(colours: NDArray[Any]) -> NDArray[Any]:
    """Return the brighter (...) of red and green of colours (..., 3)."""
    return np.asarray(colours[..., :2].max(-1))


def _two_levels(values: NDArray[Any]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the two levels low, high (N,) that series (T, N) are divided into with the least deviation, and that (N,); NaN is
    left out."""
    ordered = np.sort(values.astype(np.float64), 0)  # NaN last
    count = (~np.isnan(ordered)).sum(0)
    sums, squares = np.cumsum(np.nan_to_num(ordered), 0), np.cumsum(np.nan_to_num(ordered) ** 2, 0)
    number = np.arange(1, len(ordered))[:, None]
    left = np.maximum(count - number, 1)
    low, high = sums[:-1] / number, (sums[-1] - sums[:-1]) / left
    within = squares[:-1] - number * low**2 + (squares[-1] - squares[:-1]) - left * high**2
    within[(number < 2) | (count - number < 2)] = np.inf
    best, every = within.argmin(0), np.arange(values.shape[1])
    spread = np.sqrt(np.maximum(within[best, every], 0) / np.maximum(count, 1))
    enough = np.isfinite(spread) & (count >= LEAST_IMAGES)
    return low[best, every], np.where(enough, high[best, every], low[best, every]), np.maximum(spread, 0.01)


def _lamp(
    size_m: FloatArray, faces: list[_Face], texels: NDArray[np.int64], recorded: NDArray[np.float32],
    colours: NDArray[np.float32], same: NDArray[np.int64],
    opposite: NDArray[np.int64], times_s: FloatArray, px_per_m: FloatArray,
) -> ActorLamp | None:  # fmt: skip
    """Return the lamp of texels that change together, and of those that change the other way; None where they are none."""
    members = np.concatenate([same, opposite])
    area_px = np.array([faces[number].texel_m for number in texels]) ** 2 * px_per_m.max() ** 2
    if area_px[members].sum() < LEAST_AREA_PX / 2:
        return None
    levels = _brightness(colours[:, members])
    low, high, _ = _two_levels(levels)
    level = (levels - low) / np.maximum(high - low, 1e-6)
    level[:, len(same) :] = 1 - level[:, len(same) :]
    rows = np.flatnonzero((~np.isnan(level)).mean(1) > 0.5)
    series = _medians(level[rows].T)
    if len(rows) < LEAST_IMAGES:
        return None
    (off,), (on,), (spread,) = _two_levels(series[:, None])
    shown = (series > (off + on) / 2).astype(np.int64)
    runs = [state for state in (0, 1) if ((shown[1:] == state) & (shown[:-1] == state)).any()]
    if on - off < LEAST_GROUP_GAP * spread or len(runs) < 2:
        return None
    weight = (px_per_m[rows] ** 2)[:, None, None]
    looks, drawn = (
        np.stack([_means(x[rows][shown == state], weight[shown == state]) for state in (0, 1)])
        for x in (colours, recorded)
    )
    words, parts = [], []
    for lit, some in ((1, same), (0, opposite)):
        near = np.zeros(len(texels), bool)
        near[some] = True
        part = (_counted(faces, texels, near, RIM_TEXELS) > 0.5) & _glows(looks[lit], looks[1 - lit])
        solid = (_counted(faces, texels, part, 1)[part] > 6.5).sum() >= max(LEAST_SOLID * part.sum(), 1)
        part &= bool(solid and LEAST_AREA_PX <= area_px[part].sum())
        parts.append(part)
        words.append(_colour(looks[lit][part].mean(0)) if part.any() else "")
    inside, (lit_word, unlit_word) = parts[0] | parts[1], words
    own = np.isin(texels, texels[inside])
    if not inside.any() or area_px[inside].sum() > MOST_AREA * area_px[own].sum():
        return None
    change = np.abs(_brightness(looks[1]) - _brightness(looks[0]))
    rest = change[own & (_counted(faces, texels, inside, 2 * RIM_TEXELS) < 0.5)]
    if len(rest) and np.quantile(rest, 0.9) > MOST_OF_REST * np.median(change[inside]):
        return None
    sides = looks[:, inside].mean(1)
    apart = _means(colours[rows][:, inside].swapaxes(0, 1)) - sides[shown]
    if np.linalg.norm(sides[1] - sides[0]) < LEAST_STEADY * np.sqrt((apart**2).mean(0).sum()):
        return None
    if lit_word and unlit_word and lit_word != unlit_word:
        name, states = "-".join(sorted(words, key=("red", "amber", "green").index)), (unlit_word, lit_word)
    else:
        name, states = (lit_word, ("off", "on")) if lit_word else (unlit_word, ("on", "off"))
        across = np.concatenate([face.points.reshape(-1, 3) for face in faces])[inside, 1].mean() / size_m[1]
        name += "" if abs(across) < SIDE else " left" if across > 0 else " right"
    likely, other = (
        np.exp(-0.5 * ((series - np.where(shown == 1, *pair)) / spread) ** 2) for pair in ((on, off), (off, on))
    )
    changes = np.flatnonzero(np.diff(shown)) + 1
    starts = np.concatenate([times_s[rows][:1], (times_s[rows][changes] + times_s[rows][changes - 1]) / 2])
    return ActorLamp(
        name, states, starts, shown[np.concatenate([[0], changes])],
        tuple(_patches(faces, texels, drawn, inside)), float((likely / np.maximum(likely + other, 1e-12)).mean()),
    )  # fmt: skip


def _means(values: NDArray[np.float32], weights: FloatArray | float = 1.0) -> FloatArray:
    """Return the weighted means (N, 3) of values (T, N, 3), NaN left out."""
    known = ~np.isnan(values)
    return np.asarray((np.nan_to_num(values) * weights).sum(0) / np.maximum((known * weights).sum(0), 1e-9))


def _glows(lit: FloatArray, unlit: FloatArray) -> BoolArray:
    """Return which texels (N,) look as lamps do, from colours (N, 3) in both states: bright and coloured when lit."""
    r, g, b = unlit.T
    light = linear_from_srgb(_brightness(lit)) / np.maximum(linear_from_srgb(_brightness(unlit)), 0.01)
    coloured = [np.maximum(x[:, 0] - x[:, 2], x[:, 1] - x[:, 0]) for x in (lit, unlit)]
    bright = (_brightness(lit) > LEAST_LIT) & (light > LEAST_MORE)
    return np.asarray(bright & (coloured[0] - coloured[1] > LEAST_COLOURED) & (np.maximum(r, g) > 0.85 * b))


def _colour(lit: FloatArray) -> str:
    """Return the word for a lit lamp's colour (3,)."""
    r, g, b = lit
    return "green" if g > r else "amber" if g > 0.6 * r and b < 0.8 * g else "red"


def _patches(
    faces: list[_Face], texels: NDArray[np.int64], looks: FloatArray, inside: BoolArray
) -> Iterator[LampPatch]:
    """Yield a lamp's patches with its rim, which shows less of its change."""
    change = np.abs(looks[1] - looks[0]).max(1)
    most = float(np.median(change[inside]))
    for number, face in enumerate(faces):
        own = np.flatnonzero(texels == number)
        core = inside[own].reshape(face.shape)
        if not core.any():
            continue
        part = core | (box_sums(core, RIM_TEXELS) > 0.5) & (change[own].reshape(face.shape) > RIM * most)
        rows, columns = np.flatnonzero(part.any(1)), np.flatnonzero(part.any(0))
        cut = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        colours = looks[:, own].reshape(2, *face.shape, 3)[:, cut[0], cut[1]]
        low = face.low + np.array([rows[0], columns[0]]) * face.texel_m
        share = part[cut].astype(np.float32)
        yield LampPatch(face.axis, face.side, low, face.texel_m, np.clip(colours, 0, 1).astype(np.float32), share)


def _counted(faces: list[_Face], texels: NDArray[np.int64], inside: BoolArray, reach: int) -> FloatArray:
    """Return how many texels (N,) within ``reach`` of each are inside, on its face."""
    parts = (box_sums(inside[texels == number].reshape(face.shape), reach) for number, face in enumerate(faces))
    return np.concatenate([part.reshape(-1) for part in parts])
