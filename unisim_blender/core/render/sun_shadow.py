"""Shadows of the sun that edits move: of actors that were inserted, displaced or removed, on all that a camera sees; and the
sun on these actors themselves.

A pixel's light is (A + S V): A of the sky and of all around, S of the sun, V whether the sun is seen. An edit changes V
alone, so a pixel's linear colour changes by (A + S V') / (A + S V). V is traced twice, through the parked actors of the
recording and through those that stand now. Shade of all else is where the ground of the recording is dark: a place above
the ground sees the sun where the ground does on which its own shadow falls.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import BoolArray, FloatArray, Trajectory, box_corners, invert_pose, points_in_box, transform_points
from ..sensors.frames import RenderStats
from ..sensors.rays import Rays
from ..weather.wet_ground import GROUND_M
from ..world.drive import Actor, Box, Camera, StaticCopy
from ..world.light import Sun
from ..world.replay import WorldState
from .contact_shadow import displaced
from .tracer import NEAR_M, Tracer
from .visibility import EXPOSURE_MOMENTS, copy_box, shadow_reach_m

START_M = 0.12
"""Distance from a surface at which rays to the sun begin: trained surfaces are as thick."""
SUN_RADIUS_RAD = 0.008
"""Half the angle over which a pixel's rays to the sun spread: more than the sun's 0.0047, for pixels have a size."""
DIRECTIONS = ((-0.5, -0.25), (0.25, -0.5), (0.5, 0.25), (-0.25, 0.5))
"""Places on the sun, relative to the radius."""
MAX_FACING = 1.5
"""Largest sunlight on a surface, relative to that on level ground."""
BESIDE_M = 0.3
"""Distance beyond a box at which it may still block: trained bodies end there."""
NEIGHBOURS_M = 40.0
"""Distance from a changed box within which actors of the recording are traced, too."""
EVERYWHERE_M = 2e4
RING_M, RING_SPACING_M = (0.5, 1.2, 2.0, 3.0), 0.7
"""Distances from a box at which ground is compared, and the spacing of places along its sides."""
AROUND_M, AROUND_SPACING_M, FULL_SUN = 24.0, 1.5, 0.9
"""Half a square around the camera in which ground is compared, the spacing of places in it, and the quantile of their
brightness that ground in full sun has."""
SHADE, SHADOW = (0.3, 0.7), (0.6, 1.0)
"""How many times darker than ground in the sun, relative to the sun's shadow as logarithms, a place is that begins to be, and
is, in shade; and than ground beside, in the recorded shadow of what is gone. What stood there hid ground, and the scene has
filled that in, often without a shadow."""
NEAREST = 9
"""Number of places that a point is compared with."""
ON_ACTORS, ACTORS_FACING = 0.3, 0.5
"""Part of the sun's strength by which an actor's light changes, and the largest sunlight on its surface relative to level
ground's: the scene's own light follows the ground in part, and lacquer and glass mirror the sky. Fitted on streets."""
PATCH_SPACING_M, PATCH_MARGIN_M, CAST_M = 0.5, 1.0, 10.0
"""Spacing of places where the ground's shade is looked up, how far beyond an actor's shadow, and the longest way to it."""


class _Blocker(NamedTuple):
    """Something that casts a shadow: its poses (K, 4, 4) over the exposure, its size (3,), whether an edit has put it
    there, or removed it; and its actor's id."""

    poses: FloatArray
    size_m: FloatArray
    changed: bool
    uid: str = ""


class GroundBeside(NamedTuple):
    """Places (M, 3) on the ground beside what has changed, world frame, that no parked actor shades, their linear brightness
    (M,), and that of ground in full sun around the camera; ``owner`` (M,) is the number of the changed box that each is
    beside."""

    points: FloatArray
    owner: NDArray[np.int64]
    brightness: FloatArray
    full_sun: float

    def level(self, points: FloatArray, owner: NDArray[np.int64]) -> FloatArray:
        """Return the brightness (N,) of the ground beside points (N, 3), of places beside the box ``owner`` (N,) alone: another
        that changes far away changes nothing here. NaN where there is none."""
        out = np.full(len(points), np.nan)
        for number in np.unique(owner[np.isin(owner, self.owner)]):
            mine, of = np.flatnonzero(owner == number), self.owner == number
            for part in np.array_split(mine, len(mine) // 4096 + 1):
                apart = np.linalg.norm(points[part, None, :2] - self.points[None, of, :2], axis=-1)
                nearest = np.argsort(apart, axis=1, kind="stable")[:, :NEAREST]
                out[part] = np.median(self.brightness[of][nearest], 1)
        return out

    def sunlit(self, levels: FloatArray, sun: Sun) -> FloatArray:
        """Return how surely (N,) in 0..1 ground of a brightness (N,) is not in shade; NaN counts as in the sun."""
        darker = self.full_sun / np.maximum(np.nan_to_num(levels, nan=self.full_sun), 1e-4)
        return 1 - _is_darker(darker, np.full(len(darker), 1 / (1 - np.mean(sun.strength))), SHADE)


@dataclass(frozen=True)
class SunPatch:
    """How much of the sun the ground sees past what stands still, 0 to 1, in a rectangle of places (X, Y), `PATCH_SPACING_M`
    apart in the world; the first is at ``low`` (2,). NaN where no ground is known."""

    low: FloatArray
    visible: FloatArray

    def at(self, points: FloatArray) -> FloatArray:
        """Return what is seen at points (N, 3), world frame: bilinear, and beyond the rectangle as at its edge."""
        place = np.clip((points[:, :2] - self.low) / PATCH_SPACING_M, 0, np.array(self.visible.shape) - 1)
        x, y = np.minimum(place.astype(np.int64), np.array(self.visible.shape) - 2).T
        (u, v), values = place.T - (x, y), self.visible
        rows = (values[i, y] * (1 - v) + values[i, y + 1] * v for i in (x, x + 1))
        return np.asarray(next(rows) * (1 - u) + next(rows) * u)


class Relit(NamedTuple):
    """An actor that stands elsewhere than in the recording, and as it stood there; and the rectangles of ground on which their
    shadows fall: the first place (2,), how many along x and y, and all (N, 3)."""

    actors: tuple[Actor, Actor]
    grounds: tuple[tuple[FloatArray, tuple[int, int], FloatArray], ...]

    def where_recorded(self, at: Rays) -> Rays:
        """Return points of the actor, and directions there, where it was recorded."""
        actor, recorded = self.actors
        here, there = (each.world_from_actor.at(at.time_s) for each in self.actors)
        local = np.einsum("nji,nj->ni", here[:, :3, :3], at.origins - here[:, :3, 3]) / actor.scale * recorded.scale
        places = np.einsum("nij,nj->ni", there[:, :3, :3], local) + there[:, :3, 3]
        turned = np.einsum("nij,nkj,nk->ni", there[:, :3, :3], here[:, :3, :3].swapaxes(1, 2), at.directions)
        return Rays(places, turned, at.time_s)


@dataclass
class SunShadows:
    """The sun over an exposure, and what blocks it, ``edited`` and as it was ``recorded``: states of blockers alone."""

    sun: Sun
    edited: WorldState
    recorded: WorldState
    actors: tuple[Actor, ...]
    """Those that an edit has inserted, displaced or changed."""
    bare: WorldState
    """The world without actors."""
    ring: FloatArray
    """Places (M, 3) beside what has changed, world frame, at the height of its underside."""
    ring_owner: NDArray[np.int64]
    """Number (M,) of the changed box that each is beside."""
    relit: tuple[Relit, ...]
    """Actors that are lit for where they stand."""
    parked: tuple[Box, ...]
    """Boxes of the recording's parked actors: nobody saw the ground in them."""
    _blockers: tuple[tuple[_Blocker, ...], tuple[_Blocker, ...]]

    def factors(
        self, points: FloatArray, time_s: FloatArray, instance: Sequence[str], which: NDArray[np.int32],
        facing: Callable[[BoolArray], FloatArray], tracers: Mapping[str, Tracer[Any]],
        brightness: FloatArray, beside: Callable[[], GroundBeside],
    ) -> FloatArray:  # fmt: skip
        """Return the factors (N, 3) of the light of points (N, 3), world frame, at times (N,). ``which`` (N,) are their
        actors' numbers in ``instance``, plus 1, 0 for none; ``facing`` returns unit normals (M, 3) of some (N,);
        ``tracers`` are those of the states ``edited`` and ``recorded``; ``brightness`` (N,) is linear; ``beside``
        returns the ground beside what has changed."""
        out = np.ones((len(points), 3))
        if not self.sun.casts:
            return out
        toward = self.sun.direction
        start = np.full(len(points), START_M)
        candidates, is_own = np.zeros((2, len(points)), bool)
        owner = np.full(len(points), -1)
        own = {box.uid: box for box in self._blockers[0] if box.uid}
        for number, uid in enumerate(instance, 1):
            mine = np.flatnonzero(which == number)
            if not len(mine) or uid not in own:
                continue
            is_own[mine] = True
            # its own shadow on itself is part of its appearance
            start[mine] = np.maximum(_span(own[uid], points[mine], toward)[1], 0) + START_M
        changed = [[b for b in group if b.changed] for group in self._blockers]
        for number, box in enumerate((*changed[0], *changed[1])):
            reach = shadow_reach_m(self.sun, box.size_m)
            enter, leave = _span(box, points, toward)
            reached = (enter <= np.minimum(leave, reach)) & (leave > start)
            owner[reached & ~candidates] = number
            candidates |= reached
        some = np.flatnonzero(candidates)
        if not len(some):
            return out
        now, before = (
            self._visible(points[some], time_s[some], start[some], group, tracers[name])
            for group, name in zip(self._blockers, ("edited", "recorded"), strict=True)
        )
        before[is_own[some]] = 1
        moved, levels = now != before, np.full(len(some), np.nan)
        if moved.any():
            ring = beside()
            levels[moved] = ring.level(points[some][moved], owner[some][moved])
            sunlit = ring.sunlit(levels[moved], self.sun)
            now[moved], before[moved] = now[moved] * sunlit, before[moved] * sunlit
        level = np.zeros(len(points), bool)
        level[some] = (which[some] == 0) & (np.abs(tracers["edited"].heights(points[some])) < GROUND_M)
        matter = np.zeros(len(points), bool)
        matter[some] = now != before
        weight = np.ones(len(points))
        tilted = matter & ~level
        if tilted.any():
            weight[tilted] = np.clip(facing(tilted) @ toward / toward[2], 0, MAX_FACING)
        strength = np.array(self.sun.strength)
        ratio = (strength / (1 - strength)) * weight[some, None]
        factors = (1 + ratio * now[:, None]) / (1 + ratio * before[:, None])
        lighter = factors.max(1) > 1
        factors[lighter] = capped(factors[lighter], brightness[some][lighter], levels[lighter])
        out[some] = factors
        return out

    def gain(
        self, relit: Relit, patches: Sequence[SunPatch], at: Rays, heights: Callable[[FloatArray], FloatArray]
    ) -> FloatArray:
        """Return the factors (N, 3) by which the sun's light on an actor, at points and times (N,) and with unit normals that
        ``at`` has as origins and directions, differs from that on it where it was recorded. ``patches`` are the shade on both
        grounds, ``heights`` returns heights of points above the ground."""
        toward, strength = self.sun.direction, np.array(self.sun.strength)
        light = []
        for here, patch in zip((at, relit.where_recorded(at)), patches, strict=True):
            cast = np.clip(heights(here.origins) / toward[2], 0, CAST_M)[:, None] * toward
            weight = ON_ACTORS * np.clip(here.directions @ toward / toward[2], 0, ACTORS_FACING)
            light.append(1 + strength / (1 - strength) * (weight * patch.at(here.origins - cast))[:, None])
        return np.nan_to_num(light[0] / light[1], nan=1.0)

    def is_open(self, points: FloatArray) -> BoolArray:
        """Return which points (N, 3) lie in no parked actor of the recording: nobody saw the ground below."""
        out = np.ones(len(points), bool)
        for box in self.parked:
            out &= ~points_in_box(points, box.world_from_box, np.asarray(box.size_m) + BESIDE_M)
        return out

    def patches(
        self, relit: Relit, points: FloatArray, known: BoolArray, brightness: FloatArray, beside: GroundBeside
    ) -> list[SunPatch]:
        """Return the shade on the grounds (N, 3) of an actor, by their linear brightness (N,), where that is ``known``."""
        ends = np.cumsum([len(ground[2]) for ground in relit.grounds])
        out = []
        for (low, shape, _), end in zip(relit.grounds, ends, strict=True):
            part = slice(end - shape[0] * shape[1], end)
            there, none = known[part], np.zeros(shape[0] * shape[1], np.int64)
            ground = GroundBeside(points[part][there], none[there], brightness[part][there], beside.full_sun)
            levels = ground.level(points[part], none)
            out.append(
                SunPatch(low, np.where(np.isnan(levels), np.nan, ground.sunlit(levels, self.sun)).reshape(shape))
            )
        return out

    def in_recorded_sun(self, points: FloatArray, time_s: float, tracer: Tracer[Any]) -> BoolArray:
        """Return which points (N, 3) no parked actor shades, by the tracer of ``recorded``."""
        times, start = np.full(len(points), time_s), np.full(len(points), START_M)
        return np.asarray(self._visible(points, times, start, self._blockers[1], tracer) == 1)

    def _visible(
        self, points: FloatArray, time_s: FloatArray, start: FloatArray,
        blockers: Sequence[_Blocker], tracer: Tracer[Any],
    ) -> FloatArray:  # fmt: skip
        """Return how much (N,) of the sun is seen past blockers."""
        blocked = np.zeros(len(points))
        for direction in self._directions():
            furthest = np.full(len(points), -np.inf)
            for box in blockers:
                enter, leave = _span(box, points, direction)
                furthest = np.where((enter <= leave) & (leave > start), np.maximum(furthest, leave), furthest)
            some = np.flatnonzero(furthest > -np.inf)
            if not len(some):
                continue
            origins = points[some] + (start[some] - NEAR_M)[:, None] * direction
            rays = Rays(origins, np.repeat(direction[None], len(some), 0), time_s[some])
            hits = tracer.active.mesh_actors.hit_by_rays(rays, NEAR_M)
            depth = tracer.trace(rays, {"depth"}, False, hits, RenderStats()).maps["depth"]
            blocked[some] += depth - NEAR_M + start[some] < furthest[some] + BESIDE_M
        return 1 - blocked / len(DIRECTIONS)

    def _directions(self) -> Iterator[FloatArray]:
        """Yield unit directions (3,) to places on the sun."""
        toward = self.sun.direction
        side = np.cross(toward, [0.0, 0.0, 1.0] if toward[2] < 0.99 else [1.0, 0.0, 0.0])
        side /= np.linalg.norm(side)
        for a, b in DIRECTIONS:
            direction = toward + SUN_RADIUS_RAD * (a * side + b * np.cross(side, toward))
            yield direction / np.linalg.norm(direction)


def sun_shadows(
    state: WorldState, camera: Camera, recorded: Mapping[str, Actor] | None, parked: Mapping[str, Box]
) -> SunShadows | None:
    """Return the shadows of a state beside those of the recording, whose actors are ``recorded`` and ``parked``; None
    where no edit changes any."""
    if state.light is None or recorded is None:
        return None
    moved = {actor.uid for actor in displaced(state, recorded)}
    actors = tuple(
        actor
        for actor in state.actors
        if actor.uid in state.light.changed
        and actor.visible_to(camera)
        and (actor.inserted or actor.appearance.mesh or actor.uid in moved)
    )
    gone = {box.content() for box in state.removed_boxes}
    standing = {
        uid: replace(recorded[uid], start_s=state.start_s, end_s=state.end_s)
        for uid in sorted(parked)
        if uid in recorded
    }
    removed = {uid for uid in standing if parked[uid].content() in gone}
    statics = tuple(
        StaticCopy(f"removed-{i}", box, box.world_from_box)
        for i, box in enumerate(state.removed_boxes)
        if box.content() not in {parked[uid].content() for uid in removed}
    )
    if not (actors or removed or statics or state.static_copies):
        return None
    replaced = {actor.uid for actor in actors}
    moments = np.linspace(state.start_s, state.end_s, EXPOSURE_MOMENTS)
    now = [_Blocker(a.world_from_actor.at(moments), a.size_m, True, a.uid) for a in actors]
    now += [_blocker(copy_box(copy), True) for copy in state.static_copies]
    before = [_blocker(parked[uid], True) for uid in sorted(removed | replaced & set(standing))]
    before += [_blocker(copy_box(copy), True) for copy in statics]
    relit = tuple(each for actor in actors for each in _relit(actor, state, recorded, state.light.sun))
    stood = [each.actors[1].world_from_actor.positions[0] for each in relit]
    places = np.array([*(b.poses[0, :3, 3] for b in (*now, *before)), *stood])
    near = [
        uid
        for uid in standing
        if np.linalg.norm(places - parked[uid].world_from_box[:3, 3], axis=1).min() < NEIGHBOURS_M
    ]
    stay = [uid for uid in near if uid not in removed | replaced]
    beside = [_blocker(parked[uid], False) for uid in stay]
    everywhere = np.eye(4)
    everywhere[:3, 3] = places[0]
    bare = replace(
        state, light=None, weather=None, actors=(), static_copies=(),
        removed_boxes=(Box(everywhere, np.full(3, EVERYWHERE_M)),),
    )  # fmt: skip

    def ordered(some: Sequence[Actor]) -> tuple[Actor, ...]:
        return tuple(sorted(some, key=lambda actor: actor.uid))

    return SunShadows(
        state.light.sun,
        replace(bare, actors=ordered([*actors, *(standing[uid] for uid in stay)]), static_copies=state.static_copies),
        replace(bare, actors=ordered([standing[uid] for uid in near]), static_copies=statics),
        actors,
        replace(bare, removed_boxes=state.removed_boxes),
        *_ring([b for b in (*now, *before) if b.changed], [parked[uid] for uid in near]),
        relit,
        tuple(parked[uid] for uid in sorted(parked)),
        (tuple([*now, *beside]), tuple([*before, *beside])),
    )


def _relit(actor: Actor, state: WorldState, recorded: Mapping[str, Actor], sun: Sun) -> Iterator[Relit]:
    """Yield what lights an actor for where it stands, of one that this scene has recorded."""
    source = recorded.get(actor.appearance.actor)
    if source is None or actor.appearance.scene or actor.appearance.mesh or not sun.casts:
        return
    times = np.array([state.start_s, (state.start_s + state.end_s) / 2, state.end_s])
    keys = source.world_from_actor.times_s
    pose = source.world_from_actor.at(np.clip(times[1:2], keys[0], keys[-1]))
    stood = replace(source, world_from_actor=Trajectory.from_poses(times[1:2], pose))
    grounds = (_cast_on(actor.world_from_actor.at(times), actor.size_m, sun), _cast_on(pose, source.size_m, sun))
    yield Relit((actor, stood), grounds)


def _cast_on(poses: FloatArray, size_m: FloatArray, sun: Sun) -> tuple[FloatArray, tuple[int, int], FloatArray]:
    """Return the rectangle of places on which the shadows of a box at poses (K, 4, 4) fall, if nothing is higher than its
    underside: the first (2,), how many there are along x and y, and all of them (X Y, 3), world frame."""
    corners = np.concatenate([box_corners(pose, size_m) for pose in poses])
    low = corners[:, 2].min()
    cast = np.minimum((corners[:, 2:] - low) / sun.direction[2], CAST_M) * sun.direction
    ends = np.concatenate([corners, corners - cast])[:, :2]
    first = np.floor((ends.min(0) - PATCH_MARGIN_M) / PATCH_SPACING_M).astype(np.int64)
    count = np.ceil((ends.max(0) + PATCH_MARGIN_M) / PATCH_SPACING_M).astype(np.int64) - first + 1
    cells = (np.indices(count).reshape(2, -1).T + first) * PATCH_SPACING_M
    return first * PATCH_SPACING_M, (int(count[0]), int(count[1])), np.c_[cells, np.full(len(cells), low)]


def capped(factors: FloatArray, brightness: FloatArray, beside: FloatArray) -> FloatArray:
    """Return factors (N, 3), each above 1 in a channel, for points of linear ``brightness`` (N,) so that they lift what is
    darker than the ground ``beside`` (N,), and make none brighter than that; none where that is NaN."""
    limit = np.maximum(np.nan_to_num(beside, nan=0.0) / np.maximum(brightness, 1e-4), 1)
    more = factors - 1
    part_of_it = np.clip((limit - 1) / np.maximum(more.mean(1), 1e-6), 0, 1)
    part_of_it *= _is_darker(limit, factors.mean(1), SHADOW)
    return np.where(more > 0, 1 + more * part_of_it[:, None], factors)


def _is_darker(ratio: FloatArray, shadow: FloatArray, ends: tuple[float, float]) -> FloatArray:
    """Return how surely (N,) in 0..1 a place is in a shadow that makes it ``shadow`` (N,) times darker, by how many times
    darker it is: 0 and 1 at the ``ends``."""
    part = np.log(np.maximum(ratio, 1)) / np.maximum(np.log(shadow), 1e-6)
    return np.clip((part - ends[0]) / (ends[1] - ends[0]), 0, 1)


def around(position: FloatArray) -> FloatArray:
    """Return places (M, 3) in a square around a position (3,), world frame."""
    steps = np.arange(-AROUND_M, AROUND_M + 1e-6, AROUND_SPACING_M)
    x, y = (axis.reshape(-1) for axis in np.meshgrid(steps, steps))
    return position + np.stack([x, y, np.zeros_like(x)], -1)


def _ring(changed: Sequence[_Blocker], parked: Sequence[Box]) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return places (M, 3) beside boxes that have changed and in none that was parked, at the height of their undersides,
    and the numbers (M,) of the boxes."""
    parts, numbers = [np.zeros((0, 3))], [np.zeros(0, np.int64)]
    for number, box in enumerate(changed):
        for beside in RING_M:
            half = box.size_m[:2] / 2 + beside
            steps = [np.arange(-h, h, RING_SPACING_M) for h in half]
            ends = [np.stack([steps[0], np.full_like(steps[0], end)], -1) for end in (-half[1], half[1])]
            ends += [np.stack([np.full_like(steps[1], end), steps[1]], -1) for end in (-half[0], half[0])]
            local = np.concatenate(ends)
            low = np.full((len(local), 1), -box.size_m[2] / 2)
            parts.append(transform_points(box.poses[0], np.concatenate([local, low], 1)))
            numbers.append(np.full(len(local), number))
    points, owner = np.concatenate(parts), np.concatenate(numbers)
    for other in parked:
        outside = ~points_in_box(points, other.world_from_box, np.asarray(other.size_m) + BESIDE_M)
        points, owner = points[outside], owner[outside]
    return points, owner


def _blocker(box: Box, changed: bool) -> _Blocker:
    return _Blocker(box.world_from_box[None], np.asarray(box.size_m), changed)


def _span(box: _Blocker, points: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distances (N,) at which rays from points enter a box at any of its poses, and at which they leave it;
    inf and -inf where they miss it."""
    enter, leave = np.full(len(points), np.inf), np.full(len(points), -np.inf)
    half = box.size_m / 2
    for pose in box.poses[:1] if (box.poses == box.poses[0]).all() else box.poses:
        local, along = transform_points(invert_pose(pose), points), direction @ pose[:3, :3]
        safe = np.where(np.abs(along) < 1e-9, 1e-9, along)
        a, b = (-half - local) / safe, (half - local) / safe
        first, last = np.minimum(a, b).max(1), np.maximum(a, b).min(1)
        hit = (first <= last) & (last > 0)
        enter, leave = np.where(hit, np.minimum(enter, first), enter), np.where(hit, np.maximum(leave, last), leave)
    return enter, leave
