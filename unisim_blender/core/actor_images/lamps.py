"""Lamps that a log shows in two states: texels of actors' boxes whose colours jump between two values together.

Each image that shows a side of an actor's box gives its texels their colours, less what changes all around them: exposure,
shade. Texels between whose two levels there is nothing, and which change at the same times, are a lamp where they are small,
red, amber or green when lit, and lit in neighbouring images. White ones are not told from reflections.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
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

VERSION = 2  # of the cache: raised when the same log gives other lamps
SIDES = ((0, 1), (0, -1), (1, 1), (1, -1))  # axes of a box's upright sides, and where on them
TEXELS, LEAST_TEXEL_M = 160, 0.02  # along a box's longest edge; the smallest edge of a texel
LEAST_PX_PER_M, LEAST_COSINE = 15.0, 0.35  # of a texel that is looked at, and of its normal and the line of sight
LEAST_IMAGES = 8  # that show a texel
LEAST_CONTRAST, LEAST_GAP, LEAST_GROUP_GAP = (
    0.15,
    3.5,
    4.5,
)  # between two levels: sRGB, and deviations of a texel, a lamp
AGREE = 0.9  # part of the images in which texels of a lamp are in the same state, or in opposite ones
BLUR_M, MOST_GAIN = 0.25, 1.0  # exposure and shade change all texels so near alike, by a factor of at most e
LEAST_AREA_PX, MOST_AREA = 4.0, 0.4  # of a lamp: in the image that shows it largest, and part of its sides
RIM, RIM_TEXELS = 0.2, 2  # part of a lamp's change from which on texels so far beside belong to it
LEAST_SOLID = 0.3  # part of a lamp's texels that others surround: edges and specks that change are none
MOST_OF_REST = 0.4  # change of 90 % of the sides' rest beside the lamp's: else it is light, or the box is displaced
LEAST_STEADY = 5.0  # two colours' difference beside how each varies: what is behind a box's corner varies more
LEAST_LIT, LEAST_MORE, LEAST_COLOURED = 0.5, 1.4, 0.06  # lit: sRGB, times the unlit light, and how much more coloured
ACROSS = 0.15  # part of the box's width from its middle from which on a lamp is left or right


def cached_lamps(log: Log) -> dict[str, tuple[ActorLamp, ...]] | None:
    """Return the lamps that `lamps_in` has cached; None where there are none, or their file is broken."""
    cached = cached_file(log, "lamps", f"{VERSION}.json")
    if not cached.is_file():
        return None
    try:
        members = Node(read_json(cached, LogError), f"{cached}: ", LogError).members()
        return {uid: tuple(map(ActorLamp.from_json, lamps.elements())) for uid, lamps in members}
    except UnisimError:
        return None


def lamps_in(log: Log, progress: Callable[[float], object] = lambda share: None) -> dict[str, tuple[ActorLamp, ...]]:
    """Return the lamps of a log's actors that it shows in two states, by their ids; from the cache where it was searched before.

    ``progress`` is called with fractions from 0 to 1. Raises `LogError` where an image cannot be read.
    """
    if (lamps := cached_lamps(log)) is not None:
        return lamps
    boxes = [_Box(actor) for actor in log.drive.actors.values() if motion_of(actor.label) != "deforming"]
    done, total = 0, sum(len(log.image_frames(name)) for name in log.drive.cameras)
    for name, camera in log.drive.cameras.items():
        frames = tuple(frame for frame in log.image_frames(name) if frame in camera.time_s)
        views = actors_in_images([box.actor for box in boxes], camera, frames)
        for column, frame in enumerate(frames):
            image = log.image(name, frame) if views.there[:, column].any() else None
            for number in np.flatnonzero(views.there[:, column]):
                nearer = views.there[:, column] & (views.depth_m[:, column] < views.depth_m[number, column] - 0.1)
                boxes[number].look(image, camera, camera.time_s[frame], views.cut[nearer, column])
            progress((done := done + 1) / total)
    lamps = {box.actor.uid: some for box in boxes if (some := tuple(box.lamps()))}
    document = {uid: [lamp.to_json() for lamp in some] for uid, some in lamps.items()}
    write_cached(cached_file(log, "lamps", f"{VERSION}.json"), json.dumps(document).encode())
    return lamps


class _Box:
    """The sides of an actor's box, unrolled: texels (K, H) in rows upwards, with gaps between the sides; N = K x H."""

    def __init__(self, actor: Actor) -> None:
        self.actor, size = actor, actor.size_m
        self.texel_m = max(float(size.max()) / TEXELS, LEAST_TEXEL_M)
        self.reach = round(BLUR_M / self.texel_m)
        middles = [(np.arange(n) - (n - 1) / 2) * self.texel_m for n in np.ceil(size / self.texel_m).astype(int)]
        self.side = np.concatenate([[n] * len(middles[1 - SIDES[n][0]]) + [-1] * self.reach for n in range(4)])
        self.points = np.zeros((len(self.side), len(middles[2]), 3))
        self.normals = np.zeros((len(self.side), 3))
        for number, (axis, side) in enumerate(SIDES):
            own = self.side == number
            self.normals[own, axis] = side
            self.points[own] = np.stack(np.broadcast_arrays(0.0, middles[1 - axis][:, None], middles[2]), -1)
            self.points[own, :, 1 - axis] = self.points[own, :, 1]
            self.points[own, :, axis] = side * size[axis] / 2
        self.samples: list[tuple[float, float, NDArray[np.float16]]] = []

    def look(self, image: NDArray[np.uint8], camera: Camera, time_s: float, nearer: FloatArray) -> None:
        """Sample an image (H, W, 3) of a time, in which ``nearer`` (M, 4) covers rectangles."""
        model, moment = camera.model, time_s
        for _ in range(2):  # once more at the time of the line that shows it
            pose = invert_pose(camera.world_from_camera.at(moment)) @ self.actor.world_from_actor.at(moment)
            u, v, _ = model.project(pose[:3, 3])
            moment = float(line_times(camera, time_s, lines(model, u, v)))
        if model.pixels_per_rad / np.linalg.norm(pose[:3, 3]) < LEAST_PX_PER_M:
            return
        eye = -pose[:3, 3] @ pose[:3, :3]
        facing = np.flatnonzero(((eye - self.points[:, 0]) * self.normals).sum(1) > 0)
        at = transform_points(pose, self.points[facing])
        distance = np.linalg.norm(at, axis=-1)
        cosine = -(at * (self.normals[facing] @ pose[:3, :3].T)[:, None]).sum(-1) / distance
        u, v, clear = model.project(at)
        clear &= (cosine > LEAST_COSINE) & (u > 1) & (u < model.width - 1) & (v > 1) & (v < model.height - 1)
        for left, top, right, bottom in nearer:
            clear &= ~((u > left) & (u < right) & (v > top) & (v < bottom))
        if clear.any():
            colours = np.full(self.points.shape, np.nan, np.float16)
            rows, columns = np.nonzero(clear)
            colours[facing[rows], columns] = bilinear(image, u[clear], v[clear]) / 255
            self.samples.append((time_s, model.pixels_per_rad / float(np.median(distance[clear])), colours))

    def lamps(self) -> Iterator[ActorLamp]:
        """Yield the box's lamps, by what was sampled."""
        if len(self.samples) < LEAST_IMAGES:
            return
        self.samples.sort(key=lambda sample: sample[0])
        self.times_s, self.px_per_m = np.array([sample[:2] for sample in self.samples]).T
        self.area_px = (self.texel_m * self.px_per_m.max()) ** 2
        recorded = np.stack([colours for _, _, colours in self.samples])
        often = (~np.isnan(recorded[..., 0])).sum(0).max(1) >= LEAST_IMAGES
        sides = np.isin(self.side, [-1, *self.side[often]])
        self.side, self.points, recorded = self.side[sides], self.points[sides], recorded[:, sides].astype(np.float32)
        self.shape = self.points.shape[:2]
        bright = recorded.mean(3)
        usual = np.nan_to_num(_medians(bright.reshape(len(bright), -1)), nan=1.0).reshape(self.shape)
        change = np.log(np.maximum(bright, 0.03) / np.maximum(usual, 0.03)).clip(-MOST_GAIN, MOST_GAIN)
        known = box_sums(~np.isnan(change), self.reach)
        gains = np.exp(box_sums(np.nan_to_num(change), self.reach) / np.maximum(known, 1))
        self.recorded, self.colours = (
            x.reshape(len(bright), -1, 3) for x in (recorded, recorded / gains[..., None].astype(np.float32))
        )
        self.levels = _brightness(self.colours)
        self.low, self.high, spread = _two_levels(self.levels)
        apart = self.high - self.low
        left, names = np.flatnonzero((apart > LEAST_CONTRAST) & (apart > LEAST_GAP * spread)), set()
        states = np.sign(self.levels - (self.low + self.high) / 2)[:, left]
        while len(left):
            seed = int(apart[left].argmax())
            alike = states * states[:, [seed]]  # 1 or -1, NaN where one is not seen
            agree = (alike > 0).sum(0) / np.maximum((~np.isnan(alike)).sum(0), 1)
            agree[seed] = 1.0
            lamp = self._lamp(left[agree >= AGREE], left[agree <= 1 - AGREE])
            if lamp is not None and lamp.name not in names:
                names.add(lamp.name)
                yield lamp
            others = (agree < AGREE) & (agree > 1 - AGREE)
            left, states = left[others], states[:, others]

    def _lamp(self, same: NDArray[np.int64], opposite: NDArray[np.int64]) -> ActorLamp | None:
        """Return the lamp of texels that change together, and of those that change the other way; None where they are none."""
        members = np.concatenate([same, opposite])
        level = (self.levels[:, members] - self.low[members]) / np.maximum(self.high - self.low, 1e-6)[members]
        level[:, len(same) :] = 1 - level[:, len(same) :]
        rows = np.flatnonzero((~np.isnan(level)).mean(1) > 0.5)
        if len(rows) < LEAST_IMAGES or self.area_px * len(members) < LEAST_AREA_PX / 2:
            return None
        series, times_s = _medians(level[rows].T), self.times_s[rows]
        levels, (spread,) = np.split(np.concatenate(_two_levels(series[:, None])), [2])
        shown = (series > levels.mean()).astype(np.int64)
        lasting = shown[1:][shown[1:] == shown[:-1]]
        if np.ptp(levels) < LEAST_GROUP_GAP * spread or len(np.unique(lasting)) < 2:
            return None
        weight = (self.px_per_m[rows] ** 2)[:, None, None]
        looks, drawn = (
            np.stack([_means(x[rows][shown == state], weight[shown == state]) for state in (0, 1)])
            for x in (self.colours, self.recorded)
        )
        parts, words = np.zeros((2, self.side.size * self.shape[1]), bool), ["", ""]
        for lit, some in ((0, opposite), (1, same)):
            parts[lit, some] = True
            parts[lit] = (self._around(parts[lit], RIM_TEXELS) > 0.5) & _glows(looks[lit], looks[1 - lit])
            solid = (self._around(parts[lit], 1)[parts[lit]] > 6.5).sum() >= max(LEAST_SOLID * parts[lit].sum(), 1)
            parts[lit] &= bool(solid and self.area_px * parts[lit].sum() >= LEAST_AREA_PX)
            if parts[lit].any():
                r, g, b = looks[lit, parts[lit]].mean(0)
                words[lit] = "green" if g > r else "amber" if g > 0.6 * r and b < 0.8 * g else "red"
        inside, side = parts.any(0), np.repeat(self.side, self.shape[1])
        own = np.isin(side, side[inside])
        if not inside.any() or inside.sum() > MOST_AREA * own.sum():
            return None
        change = np.abs(_brightness(looks[1]) - _brightness(looks[0]))
        rest = change[own & (self._around(inside, 2 * RIM_TEXELS) < 0.5)]
        sides = looks[:, inside].mean(1)
        apart = _means(self.colours[rows][:, inside].swapaxes(0, 1)) - sides[shown]
        steady = np.linalg.norm(sides[1] - sides[0]) >= LEAST_STEADY * np.sqrt((apart**2).mean(0).sum())
        if not steady or (len(rest) and np.quantile(rest, 0.9) > MOST_OF_REST * np.median(change[inside])):
            return None
        name, states = "-".join(sorted(words, key=["red", "amber", "green", ""].index)), (words[0], words[1])
        if not all(words) or words[0] == words[1]:
            across = self.points.reshape(-1, 3)[inside, 1].mean() / self.actor.size_m[1]
            name = (words[1] or words[0]) + ("" if abs(across) < ACROSS else " left" if across > 0 else " right")
            states = ("off", "on") if words[1] else ("on", "off")
        unlike = (series - levels[shown]) ** 2 - (series - levels[1 - shown]) ** 2
        certainty = float((1 / (1 + np.exp(unlike / (2 * spread**2)))).mean())
        at = np.flatnonzero(np.diff(shown)) + 1
        starts = np.concatenate([times_s[:1], (times_s[at] + times_s[at - 1]) / 2])
        return ActorLamp(name, states, starts, shown[[0, *at]], tuple(self._patches(drawn, inside)), certainty)

    def _patches(self, looks: FloatArray, inside: BoolArray) -> Iterator[LampPatch]:
        """Yield a lamp's patches with its rim, which shows less of its change."""
        change = np.abs(looks[1] - looks[0]).max(1)
        rim = (self._around(inside, RIM_TEXELS) > 0.5) & (change > RIM * float(np.median(change[inside])))
        for number, (axis, side) in enumerate(SIDES):
            part = (inside | rim).reshape(self.shape) & (self.side == number)[:, None]
            if (inside.reshape(self.shape) & part).any():
                cut = tuple(slice(at[0], at[-1] + 1) for at in (np.flatnonzero(part.any(other)) for other in (1, 0)))
                colours = looks.reshape(2, *self.shape, 3)[(slice(None), *cut)].clip(0, 1).astype(np.float32)
                low = np.delete(self.points[cut][0, 0], axis) - self.texel_m / 2
                yield LampPatch(axis, side, low, self.texel_m, colours, part[cut].astype(np.float32))

    def _around(self, inside: BoolArray, reach: int) -> FloatArray:
        """Return how many texels (N,) within ``reach`` of each are inside."""
        return box_sums(inside.reshape(self.shape), reach).reshape(-1)


def _medians(values: NDArray[Any]) -> FloatArray:
    """Return the medians (N,) of series (T, N), NaN left out; NaN where nothing is left."""
    ordered, count = np.sort(values, 0), (~np.isnan(values)).sum(0)
    return np.asarray(ordered[np.maximum(count - 1, 0) // 2, np.arange(values.shape[1])], np.float64)


def _means(values: NDArray[Any], weights: FloatArray | float = 1.0) -> FloatArray:
    """Return the weighted means (N, 3) of values (T, N, 3), NaN left out."""
    known = ~np.isnan(values)
    return np.asarray((np.nan_to_num(values) * weights).sum(0) / np.maximum((known * weights).sum(0), 1e-9))


def _brightness(colours: NDArray[Any]) -> NDArray[Any]:
    """Return the brighter (...) of red and green of colours (..., 3)."""
    return np.asarray(colours[..., :2].max(-1))


def _two_levels(values: NDArray[Any]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the two levels low, high (N,) that series (T, N) are divided into with the least deviation, and that (N,); NaN is
    left out."""
    ordered = np.sort(values.astype(np.float64), 0)  # NaN last
    count, number = (~np.isnan(ordered)).sum(0), np.arange(1, len(ordered))[:, None]
    sums, squares = (np.cumsum(np.nan_to_num(ordered) ** power, 0) for power in (1, 2))
    left = np.maximum(count - number, 1)
    low, high = sums[:-1] / number, (sums[-1] - sums[:-1]) / left
    within = squares[-1] - number * low**2 - left * high**2
    within[(number < 2) | (count - number < 2)] = np.inf
    best, every = within.argmin(0), np.arange(values.shape[1])
    spread = np.sqrt(np.maximum(within[best, every], 0) / np.maximum(count, 1))
    enough = np.isfinite(spread) & (count >= LEAST_IMAGES)
    return low[best, every], np.where(enough, high[best, every], low[best, every]), np.maximum(spread, 0.01)


def _glows(lit: FloatArray, unlit: FloatArray) -> BoolArray:
    """Return which texels (N,) look as lamps do, from colours (N, 3) in both states: bright and coloured when lit."""
    light = linear_from_srgb(_brightness(lit)) / np.maximum(linear_from_srgb(_brightness(unlit)), 0.01)
    more, less = (np.maximum(x[:, 0] - x[:, 2], x[:, 1] - x[:, 0]) for x in (lit, unlit))
    bright = (_brightness(lit) > LEAST_LIT) & (light > LEAST_MORE) & (_brightness(unlit) > 0.85 * unlit[:, 2])
    return np.asarray(bright & (more - less > LEAST_COLOURED))
