"""Where the compiled tracer samples a ray: the march to surfaces, one ray at a time, in plain numpy.

The specification of native/cells.h and native/surface_march.h, not a fast path. First the trained distance is evaluated
once, on a grid, which gives the cells that can stop a ray at all. A ray is then divided into runs through such cells,
and marched along them: each sample bounds the step to the next. Last, the intervals that absorb most of the ray are
split. Distances come from a callback, so that the same code serves the static field, actors and surfaces
known in closed form.

All arithmetic is float32, in the kernels' order, so that the same cells are entered and the same places evaluated,
except for the rounding of exp, log and fused products.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CELLS = 2
"""Cells along each edge of a voxel."""
POINTS = 2
"""Points along each edge of a cell at which the distance is evaluated to find the cell's kind."""
BOX_CELLS = 16
"""Cells along each edge of an actor's box."""
OPEN, SOLID, SURFACE = 0, 1, 2
"""Kinds of cells: nothing in it stops a ray; it lies behind a surface; a surface may be in it."""
REACH = np.float32(0.67)
"""The distance at which a point counts as near a surface, in distances between points. The cube around a point ends
between 0.5 and 0.87 of these from it: a surface that only cuts its corners shows in the cells next to it too."""
MAX_STEPS, MAX_BOX_STEPS = np.float32(1e6), np.float32(1e4)
"""Bounds on the steps of a ray, whatever its numbers are."""
MIN_SPLIT_M = np.float32(0.01)
"""Intervals shorter than this are not split."""
PATIENCE = 24
"""After so many samples steps are twice as long, then three times, so that every march ends."""

F = np.float32
Floats = NDArray[np.float32]
Kinds = NDArray[np.uint8]
Distance = Callable[[np.float32], float]
"""The signed distance in metres at so many metres along the ray, positive in the open."""


@dataclass(frozen=True)
class Steps:
    """How a ray is marched: `unisim_sampling` has the same names."""

    opaque: float
    """Transmittance below which nothing is evaluated."""
    stride_m: float
    """The longest step that ignores the distance: objects of this thickness are never missed."""
    step_growth_per_m: float
    """Growth of that step per metre from the origin, relative."""
    relaxation: float
    """How much longer than the distance a step may be: in front of surfaces the distance is taken to fall by at least
    1 / ``relaxation`` per metre."""
    min_slope: float
    """The least fall per metre behind a surface."""
    min_step_m: float
    splits: int
    """How often an interval is split."""
    split_weight: float
    """Intervals of a smaller weight are not split."""


@dataclass(frozen=True)
class Volume:
    """The static field: cell kinds (X * CELLS, Y * CELLS, Z * CELLS) of voxels ``voxel_m`` wide, from the origin on."""

    kinds: Kinds
    voxel_m: float


@dataclass(frozen=True)
class ActorBox:
    """An actor's box about the origin: cell kinds (BOX_CELLS, BOX_CELLS, BOX_CELLS), its size (3,) in metres."""

    kinds: Kinds
    size_m: Floats


Run = tuple[np.float32, np.float32]
"""An interval, metres along the ray, in cells that can stop it."""


Occupied = Callable[[np.float32], bool]
"""Whether a ray is in a voxel that is not free, by metres along it."""


@dataclass(frozen=True)
class Before:
    """What lies before a ray's samples in the static field: from ``t_near`` on, in voxels ``voxel_m`` wide."""

    voxel_m: float
    t_near: float
    occupied: Occupied


@dataclass
class Sample:
    """The signed distance ``s`` at ``t`` metres along the ray."""

    t: np.float32
    s: np.float32
    after_free: bool = False
    """Free space lies between the sample before and this one."""


def kinds_of(s: Floats, gap_m: float) -> Kinds:
    """Kinds (X, Y, Z) of cells from the distances s (X * POINTS, Y * POINTS, Z * POINTS) at their points, ``gap_m``
    apart."""
    shape = [n // POINTS for n in s.shape]
    points = s.reshape(shape[0], POINTS, shape[1], POINTS, shape[2], POINTS)
    least, largest = points.min((1, 3, 5)), points.max((1, 3, 5))
    reach = REACH * F(gap_m)
    return np.where(least > reach, OPEN, np.where(largest < -reach, SOLID, SURFACE)).astype(np.uint8)


def kinds_in_grid(kinds: Kinds) -> Kinds:
    """Kinds (X, Y, Z) in which solid cells next to an open one, corners included, are surfaces. Outside the
    grid all is open."""
    padded = np.pad(kinds, 1, constant_values=OPEN)
    x, y, z = kinds.shape
    around = [padded[a : a + x, b : b + y, c : c + z] for a in range(3) for b in range(3) for c in range(3)]
    return np.where((kinds == SOLID) & (np.stack(around) == OPEN).any(0), SURFACE, kinds).astype(np.uint8)


def unpacked(words: NDArray[np.uint16]) -> Kinds:
    """Kinds (X * CELLS, Y * CELLS, Z * CELLS) out of a scene's `cells` (X, Y, Z): two bits a cell, the
    lowest for the first."""
    kinds = words[..., None] >> (2 * np.arange(CELLS**3, dtype=np.uint16)) & 3
    x, y, z = words.shape
    split = kinds.reshape(x, y, z, CELLS, CELLS, CELLS).transpose(0, 3, 1, 4, 2, 5)
    return np.ascontiguousarray(split.reshape(x * CELLS, y * CELLS, z * CELLS).astype(np.uint8))


def runs_in_volume(
    volume: Volume,
    origin: Floats,
    direction: Floats,
    t_near: float,
    t_far: float,
    cleared: tuple[float, float] = (np.inf, -np.inf),
) -> list[Run]:
    """Runs of a ray, origin and unit direction (3,) in the volume's axes, between two places along it.

    The ray is divided into steps of one cell along the axis of its largest direction component; a step has the kind of
    the cell at its middle. Within a voxel of the interval ``cleared``, where a box was emptied, solid cells count: they
    may face the ray now.
    """
    near, voxel = F(t_near), F(volume.voxel_m)
    inverse, o, d = F(1) / voxel, origin.astype(F), direction.astype(F)
    step = voxel / (F(CELLS) * max(np.abs(d).max(), F(0.5)))
    i = np.arange(_steps(near, F(t_far), step, MAX_STEPS), dtype=F)
    x = (o + (near + (i + F(0.5)) * step)[:, None] * d) * inverse
    inside = ((x >= 0) & (x < np.array(volume.kinds.shape, F) / F(CELLS))).all(1)
    x = np.where(inside[:, None], x, F(0))
    corner = x.astype(np.int64)
    cell = CELLS * corner + ((x - corner.astype(F)) * F(CELLS)).astype(np.int64)
    kind, middle = volume.kinds[cell[:, 0], cell[:, 1], cell[:, 2]], near + (i + F(0.5)) * step
    open_here = (middle >= F(cleared[0]) - voxel) & (middle <= F(cleared[1]) + voxel)
    counts = inside & ((kind == SURFACE) | ((kind == SOLID) & open_here))
    begins, lasts = _intervals(counts)
    runs = []
    for first, last in zip(begins, lasts, strict=True):
        # exactly where the cells' faces are: outside, the distance was not trained
        entry, _ = _cell_interval(volume, o, d, near + (F(first) + F(0.5)) * step)
        _, exit_ = _cell_interval(volume, o, d, near + (F(last) + F(0.5)) * step)
        runs.append((max(entry, near), exit_))
    return _ended(runs, F(t_far))


def _cell_interval(volume: Volume, o: Floats, d: Floats, t: np.float32) -> Run:
    """Where a ray is inside the cell that contains its point at t."""
    size = F(volume.voxel_m) / F(CELLS)
    begin, end = F(0), F(3e38)
    for a in range(3):
        if abs(d[a]) >= 1e-9:
            low = np.floor((o[a] + t * d[a]) / size) * size
            first, second = (low - o[a]) / d[a], (low + size - o[a]) / d[a]
            begin, end = max(begin, min(first, second)), min(end, max(first, second))
    return (begin, end) if begin < end else (t, t)


def runs_in_box(box: ActorBox, origin: Floats, direction: Floats, t_near: float, t_far: float) -> list[Run]:
    """Runs of a ray in the axes of an actor's box: steps of half a cell, surface cells only."""
    near, o, d, size = F(t_near), origin.astype(F), direction.astype(F), box.size_m.astype(F)
    start, along = (o / size + F(0.5)) * F(BOX_CELLS), d / size * F(BOX_CELLS)
    step = F(0.5) / max(np.abs(along).max(), F(1e-9))
    i = np.arange(_steps(near, F(t_far), step, MAX_BOX_STEPS), dtype=F)
    x = start + (near + (i + F(0.5)) * step)[:, None] * along
    cell = np.clip(x, F(0), F(BOX_CELLS - 1)).astype(np.int64)
    return _joined(box.kinds[cell[:, 0], cell[:, 1], cell[:, 2]] == SURFACE, near, F(t_far), step)


def optical_depth_at(s: np.float32, beta: float) -> np.float32:
    """-log Phi(s), the optical depth in front of a place where the distance is s, Phi(s) = sigmoid(beta s):
    `density.py`."""
    a = -F(beta) * s
    return F(0) if a < -12 else a if a > 20 else F(np.log1p(np.exp(a)))


def march_runs(runs: list[Run], distance: Distance, beta: float, how: Steps, passed: float = 0.0) -> list[Sample]:
    """Samples along a ray's runs, from the near end until the transmittance is below ``opaque``; ``passed`` is the
    optical depth before the ray.

    A run has a sample at its begin. From there on, where the distance is positive, the step goes to where the last two
    samples predict the surface, and 1.5 / beta beyond it, so that two samples enclose it, but no further than the
    stride or a multiple of the distance, whichever is longer. Behind a surface, the step leads past where it is opaque.
    A run's end has a sample where the surface could lie before it.
    """
    b, limit = F(beta), -np.log(F(how.opaque))
    total, outside = F(passed), F(0)
    shortest = max(F(how.min_step_m), F(0.5) / b)
    samples: list[Sample] = []
    for begin, end in runs if total < limit else ():
        t: np.float32 | None = begin
        while t is not None:
            fresh = t == begin
            here = Sample(t, F(distance(t)), fresh)
            closing = F(1) if fresh else (samples[-1].s - here.s) / max(here.t - samples[-1].t, F(1e-4))
            out = optical_depth_at(here.s, beta)
            total += out if not samples else max(out - outside, F(0))
            outside = out
            samples.append(here)
            if not total < limit:
                return samples
            step = max(_step(here, closing, b, limit, how), shortest) * F(1 + len(samples) // PATIENCE)
            if fresh:
                # what the first sample of a run says may be about what lies before it
                step = min(step, F(0.5) * (end - here.t), F(how.stride_m))
            if here.t + step < end and step > 0:
                t = here.t + step
            elif here.t + shortest < end and here.s < F(1.5) * (end - here.t):
                t = end
            else:
                t = None
    return samples


def _step(here: Sample, closing: np.float32, beta: np.float32, limit: np.float32, how: Steps) -> np.float32:
    longest = F(how.stride_m) * (F(1) + F(how.step_growth_per_m) * here.t)
    if here.s > 0:
        slope = min(max(closing, F(1) / F(how.relaxation)), F(1.5))
        step = here.s / slope + F(1.5) / (beta * slope) if closing > 0 else here.s
        return min(step, max(longest, F(how.relaxation) * here.s))
    slope = min(max(closing, F(how.min_slope)), F(1.5))
    return min((F(1.5) * limit / beta + here.s) / slope, longest)


def place_of_split(samples: list[Sample], beta: float, how: Steps) -> tuple[int, np.float32] | None:
    """Before which sample, and where, one more is worth most: in the interval of the largest weight, where half of that
    is absorbed if the distance is linear. None where no interval longer than `MIN_SPLIT_M` has a weight of
    ``split_weight``."""
    found = None
    best, before, last = F(how.split_weight), F(0), F(0)
    for k, sample in enumerate(samples):
        now = optical_depth_at(sample.s, beta)
        depth = now - last
        if k and depth > F(how.split_weight) and not sample.after_free and sample.t - samples[k - 1].t > MIN_SPLIT_M:
            weight = np.exp(-before) * (F(1) - np.exp(-depth))
            if weight > best:
                s0, length = samples[k - 1].s, sample.t - samples[k - 1].t
                middle = (np.exp(-last) + np.exp(-now)) / F(2)
                s = np.log(middle / max(F(1) - middle, F(1e-6))) / F(beta)
                share = min(max((s0 - s) / max(s0 - sample.s, F(1e-6)), F(0.05)), F(0.95))
                best, found = weight, (k, samples[k - 1].t + share * length)
        before += max(depth, F(0))
        last = now
    return found


def face_of(samples: list[Sample], beta: float, before: Before) -> tuple[int, np.float32] | None:
    """Where a ray leaves free space and enters a solid, the surface lies in between: it was trained by samples on both
    sides. Before which sample the free space lies, and the nearest occupied place before it, by half voxels; None
    where there is none.
    """
    step = F(before.voxel_m) / F(2)
    for k, sample in enumerate(samples):
        if optical_depth_at(sample.s, beta) < F(0.05):
            continue
        least = samples[k - 1].t + step if k else F(before.t_near)
        t = sample.t - step
        while t > least:
            if before.occupied(t):
                return k, t
            t -= step
        return None
    return None


def march(
    runs: list[Run], distance: Distance, beta: float, how: Steps, passed: float = 0.0, before: Before | None = None
) -> list[Sample]:
    """The samples of a ray, rising in t: along its runs, one before free space that ends in a solid,
    those of the splits."""
    samples = march_runs(runs, distance, beta, how, passed)
    face = None if before is None else face_of(samples, beta, before)
    if before is not None and face is not None:
        k, t = face
        samples.insert(k, Sample(t, F(distance(t))))
        samples[k + 1].after_free = bool(samples[k + 1].t - t > F(0.75) * F(before.voxel_m))
    for _ in range(how.splits):
        split = place_of_split(samples, beta, how)
        if split is None:
            break
        samples.insert(split[0], Sample(split[1], F(distance(split[1]))))
    return samples


def _steps(t_near: np.float32, t_far: np.float32, step: np.float32, limit: np.float32) -> int:
    if not t_far > t_near:
        return 0
    steps = np.ceil((t_far - t_near) / step)
    return int(steps if steps < limit else limit)


def _intervals(counts: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last steps of consecutive ones that count."""
    edges = np.diff(np.pad(counts, 1).astype(np.int8))
    return np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1


def _ended(runs: list[Run], far: np.float32) -> list[Run]:
    return [*runs[:-1], (runs[-1][0], min(runs[-1][1], far))] if runs else []


def _joined(counts: NDArray[np.bool_], near: np.float32, far: np.float32, step: np.float32) -> list[Run]:
    """Runs of the steps that count: consecutive ones are one run."""
    return _ended(
        [(near + F(i) * step, near + F(j) * step + step) for i, j in zip(*_intervals(counts), strict=True)], far
    )
