"""Where the compiled tracer samples a ray: the march to surfaces, one ray at a time, in plain numpy.

The specification of native/cells.h and native/marching.h, not a fast path. First the trained distance is asked once, on a grid,
and says which cells can stop a ray at all. A ray is then cut into runs through such cells, and along these it is walked: every
answer says how far the next place may be. Last, the intervals that stop most of the ray are split. Distances are told by a
callback, so that the same holds for what stands still, for actors and for surfaces known in closed form.

All arithmetic is float32, in the kernels' order, so that the same cells are met and the same places asked, but for the rounding
of exp, log and fused products.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CELLS = 2
"""Cells along each edge of a voxel."""
POINTS = 2
"""Points along each edge of a cell at which the distance is asked to find what the cell is."""
BOX_CELLS = 16
"""Cells along each edge of an actor's box."""
OPEN, SOLID, SURFACE = 0, 1, 2
"""What a cell is: nothing in it stops a ray; it lies behind a surface; a surface may be in it."""
REACH = np.float32(0.67)
"""How near to a surface a cell's points are that count as near it, in distances between points. The cube about a point ends
between 0.5 and 0.87 of these from it: what crosses its corners alone shows in the cells beside it too."""
MOST_STEPS, MOST_BOX_STEPS = np.float32(1e6), np.float32(1e4)
"""No ray is cut into more steps, whatever its numbers are."""
LEAST_SPLIT_M = np.float32(0.01)
"""Intervals shorter than this are not split."""
PATIENCE = 24
"""So many answers later, steps are twice as long, then three times: every walk ends."""

F = np.float32
Floats = NDArray[np.float32]
Kinds = NDArray[np.uint8]
Distance = Callable[[np.float32], float]
"""The signed distance in metres at so many metres along the ray, positive in the open."""


@dataclass(frozen=True)
class Steps:
    """How a ray is walked: `unisim_sampling` has the same names."""

    opaque: float
    """Transmittance behind which nothing is asked."""
    stride_m: float
    """The longest step that does not heed the distance: as thick a thing is never jumped over."""
    widening: float
    """How much longer such a step may be for each metre from the origin, as a share."""
    relaxation: float
    """How much longer than the distance a step may be: in the open the distance is taken to fall by at least 1 / ``relaxation``
    a metre."""
    least_slope: float
    """The same of what is behind a surface."""
    least_step_m: float
    splits: int
    """How often an interval is split."""
    split_weight: float
    """Intervals that stop a smaller share of the ray are not split."""


@dataclass(frozen=True)
class Volume:
    """What stands still: cell kinds (X * CELLS, Y * CELLS, Z * CELLS) of voxels ``voxel_m`` wide, from the origin on."""

    kinds: Kinds
    voxel_m: float


@dataclass(frozen=True)
class ActorBox:
    """An actor's box about the origin: cell kinds (BOX_CELLS, BOX_CELLS, BOX_CELLS), its size (3,) in metres."""

    kinds: Kinds
    size_m: Floats


Run = tuple[np.float32, np.float32]
"""From where to where, metres along the ray, it is in cells that can stop it."""


Occupied = Callable[[np.float32], bool]
"""Whether a ray is in a voxel that is not free, at so many metres along it."""


@dataclass(frozen=True)
class Before:
    """What lies before a ray's answers, of what stands still: from ``t_near`` on, in voxels ``voxel_m`` wide."""

    voxel_m: float
    t_near: float
    occupied: Occupied


@dataclass
class Probe:
    """An answer: the signed distance ``s`` at ``t`` metres along the ray."""

    t: np.float32
    s: np.float32
    beyond: bool = False
    """Free space lies between the answer before and this one."""


def kinds_of(s: Floats, gap_m: float) -> Kinds:
    """Kinds (X, Y, Z) of cells from the distances s (X * POINTS, Y * POINTS, Z * POINTS) at their points, ``gap_m`` apart."""
    shape = [n // POINTS for n in s.shape]
    points = s.reshape(shape[0], POINTS, shape[1], POINTS, shape[2], POINTS)
    least, largest = points.min((1, 3, 5)), points.max((1, 3, 5))
    reach = REACH * F(gap_m)
    return np.where(least > reach, OPEN, np.where(largest < -reach, SOLID, SURFACE)).astype(np.uint8)


def raised(kinds: Kinds) -> Kinds:
    """The same kinds (X, Y, Z), where solid cells beside an open one, corners included, are surfaces. Outside all is open."""
    padded = np.pad(kinds, 1, constant_values=OPEN)
    x, y, z = kinds.shape
    around = [padded[a : a + x, b : b + y, c : c + z] for a in range(3) for b in range(3) for c in range(3)]
    return np.where((kinds == SOLID) & (np.stack(around) == OPEN).any(0), SURFACE, kinds).astype(np.uint8)


def unpacked(words: NDArray[np.uint16]) -> Kinds:
    """Kinds (X * CELLS, Y * CELLS, Z * CELLS) out of a scene's `cells` (X, Y, Z): two bits a cell, the lowest for the first."""
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
    opened: tuple[float, float] = (np.inf, -np.inf),
) -> list[Run]:
    """Runs of a ray, origin and unit direction (3,) in the volume's axes, between two places along it.

    The ray is cut into steps of a cell along the axis that it follows most; each is the kind of the cell at its middle. Within a
    voxel of the stretch ``opened``, where a box was emptied, solid cells count: what was behind a surface may face the ray.
    """
    near, voxel = F(t_near), F(volume.voxel_m)
    inverse, o, d = F(1) / voxel, origin.astype(F), direction.astype(F)
    step = voxel / (F(CELLS) * max(np.abs(d).max(), F(0.5)))
    i = np.arange(_steps(near, F(t_far), step, MOST_STEPS), dtype=F)
    x = (o + (near + (i + F(0.5)) * step)[:, None] * d) * inverse
    inside = ((x >= 0) & (x < np.array(volume.kinds.shape, F) / F(CELLS))).all(1)
    x = np.where(inside[:, None], x, F(0))
    corner = x.astype(np.int64)
    cell = CELLS * corner + ((x - corner.astype(F)) * F(CELLS)).astype(np.int64)
    kind, middle = volume.kinds[cell[:, 0], cell[:, 1], cell[:, 2]], near + (i + F(0.5)) * step
    open_here = (middle >= F(opened[0]) - voxel) & (middle <= F(opened[1]) + voxel)
    counts = inside & ((kind == SURFACE) | ((kind == SOLID) & open_here))
    begins, lasts = _stretches(counts)
    runs = []
    for first, last in zip(begins, lasts, strict=True):
        # to the bit where the cells' faces are: outside nobody taught the distance
        entry, _ = _cell_about(volume, o, d, near + (F(first) + F(0.5)) * step)
        _, exit_ = _cell_about(volume, o, d, near + (F(last) + F(0.5)) * step)
        runs.append((max(entry, near), exit_))
    return _ended(runs, F(t_far))


def _cell_about(volume: Volume, o: Floats, d: Floats, t: np.float32) -> Run:
    """Where a ray is in the cell about its place t."""
    size = F(volume.voxel_m) / F(CELLS)
    begin, end = F(0), F(3e38)
    for a in range(3):
        if abs(d[a]) >= 1e-9:
            low = np.floor((o[a] + t * d[a]) / size) * size
            first, second = (low - o[a]) / d[a], (low + size - o[a]) / d[a]
            begin, end = max(begin, min(first, second)), min(end, max(first, second))
    return (begin, end) if begin < end else (t, t)


def runs_in_box(box: ActorBox, origin: Floats, direction: Floats, t_near: float, t_far: float) -> list[Run]:
    """The same of a ray in the axes of an actor's box: steps of half a cell, surfaces alone."""
    near, o, d, size = F(t_near), origin.astype(F), direction.astype(F), box.size_m.astype(F)
    start, along = (o / size + F(0.5)) * F(BOX_CELLS), d / size * F(BOX_CELLS)
    step = F(0.5) / max(np.abs(along).max(), F(1e-9))
    i = np.arange(_steps(near, F(t_far), step, MOST_BOX_STEPS), dtype=F)
    x = start + (near + (i + F(0.5)) * step)[:, None] * along
    cell = np.clip(x, F(0), F(BOX_CELLS - 1)).astype(np.int64)
    return _joined(box.kinds[cell[:, 0], cell[:, 1], cell[:, 2]] == SURFACE, near, F(t_far), step)


def stopped_at(s: np.float32, beta: float) -> np.float32:
    """-log Phi(s), what a surface has stopped of a ray where the distance is s, with Phi(s) = sigmoid(beta s): `density.py`."""
    a = -F(beta) * s
    return F(0) if a < -12 else a if a > 20 else F(np.log1p(np.exp(a)))


def walk(runs: list[Run], distance: Distance, beta: float, how: Steps, passed: float = 0.0) -> list[Probe]:
    """Answers along a ray's runs, from its near end until what is ``passed``, the optical depth, leaves less than ``opaque``.

    A run is asked at its begin. From then on, where the distance is positive, the step is what the last two answers say that the
    surface is away, and 1.5 / beta beyond it, so that the surface lies between two answers, but no longer than what could hide
    a thin thing: the stride or a multiple of the distance, the longer of them. Behind a surface the step leads past where it is
    opaque. A run's end is asked where the surface could be before it.
    """
    b, limit = F(beta), -np.log(F(how.opaque))
    total, outside = F(passed), F(0)
    least = max(F(how.least_step_m), F(0.5) / b)
    probes: list[Probe] = []
    for begin, end in runs if total < limit else ():
        t: np.float32 | None = begin
        while t is not None:
            fresh = t == begin
            here = Probe(t, F(distance(t)), fresh)
            closing = F(1) if fresh else (probes[-1].s - here.s) / max(here.t - probes[-1].t, F(1e-4))
            out = stopped_at(here.s, beta)
            total += out if not probes else max(out - outside, F(0))
            outside = out
            probes.append(here)
            if not total < limit:
                return probes
            step = max(_step(here, closing, b, limit, how), least) * F(1 + len(probes) // PATIENCE)
            if fresh:
                # what the first answer in a run says may be of what lies before it
                step = min(step, F(0.5) * (end - here.t), F(how.stride_m))
            if here.t + step < end and step > 0:
                t = here.t + step
            elif here.t + least < end and here.s < F(1.5) * (end - here.t):
                t = end
            else:
                t = None
    return probes


def _step(here: Probe, closing: np.float32, beta: np.float32, limit: np.float32, how: Steps) -> np.float32:
    longest = F(how.stride_m) * (F(1) + F(how.widening) * here.t)
    if here.s > 0:
        slope = min(max(closing, F(1) / F(how.relaxation)), F(1.5))
        step = here.s / slope + F(1.5) / (beta * slope) if closing > 0 else here.s
        return min(step, max(longest, F(how.relaxation) * here.s))
    slope = min(max(closing, F(how.least_slope)), F(1.5))
    return min((F(1.5) * limit / beta + here.s) / slope, longest)


def place_of_split(probes: list[Probe], beta: float, how: Steps) -> tuple[int, np.float32] | None:
    """Before which answer, and where, one more tells most: in the interval that stops the largest share of the ray, where half of
    that is stopped if the distance is linear. None where no interval stops ``split_weight`` over a length that matters."""
    found = None
    best, before, last = F(how.split_weight), F(0), F(0)
    for k, probe in enumerate(probes):
        now = stopped_at(probe.s, beta)
        depth = now - last
        if k and depth > F(how.split_weight) and not probe.beyond and probe.t - probes[k - 1].t > LEAST_SPLIT_M:
            weight = np.exp(-before) * (F(1) - np.exp(-depth))
            if weight > best:
                s0, length = probes[k - 1].s, probe.t - probes[k - 1].t
                middle = (np.exp(-last) + np.exp(-now)) / F(2)
                s = np.log(middle / max(F(1) - middle, F(1e-6))) / F(beta)
                share = min(max((s0 - s) / max(s0 - probe.s, F(1e-6)), F(0.05)), F(0.95))
                best, found = weight, (k, probes[k - 1].t + share * length)
        before += max(depth, F(0))
        last = now
    return found


def face_of(probes: list[Probe], beta: float, before: Before) -> tuple[int, np.float32] | None:
    """Where a ray comes out of free space into what is solid the surface lies in between: it was learnt from samples on both
    sides. Before which answer the space lies, and the nearest occupied place before it, by half voxels; None where there is none.
    """
    step = F(before.voxel_m) / F(2)
    for k, probe in enumerate(probes):
        if stopped_at(probe.s, beta) < F(0.05):
            continue
        least = probes[k - 1].t + step if k else F(before.t_near)
        t = probe.t - step
        while t > least:
            if before.occupied(t):
                return k, t
            t -= step
        return None
    return None


def march(
    runs: list[Run], distance: Distance, beta: float, how: Steps, passed: float = 0.0, before: Before | None = None
) -> list[Probe]:
    """The samples of a ray, rising in t: the walk's, one before free space that ends in what is solid, those of the splits."""
    probes = walk(runs, distance, beta, how, passed)
    face = None if before is None else face_of(probes, beta, before)
    if before is not None and face is not None:
        k, t = face
        probes.insert(k, Probe(t, F(distance(t))))
        probes[k + 1].beyond = bool(probes[k + 1].t - t > F(0.75) * F(before.voxel_m))
    for _ in range(how.splits):
        split = place_of_split(probes, beta, how)
        if split is None:
            break
        probes.insert(split[0], Probe(split[1], F(distance(split[1]))))
    return probes


def _steps(t_near: np.float32, t_far: np.float32, step: np.float32, most: np.float32) -> int:
    if not t_far > t_near:
        return 0
    steps = np.ceil((t_far - t_near) / step)
    return int(steps if steps < most else most)


def _stretches(counts: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last steps of those that count and follow each other."""
    edges = np.diff(np.pad(counts, 1).astype(np.int8))
    return np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1


def _ended(runs: list[Run], far: np.float32) -> list[Run]:
    return [*runs[:-1], (runs[-1][0], min(runs[-1][1], far))] if runs else []


def _joined(counts: NDArray[np.bool_], near: np.float32, far: np.float32, step: np.float32) -> list[Run]:
    """Runs of the steps that count: those that follow each other are one."""
    return _ended([(near + F(i) * step, near + F(j) * step + step) for i, j in zip(*_stretches(counts), strict=True)], far)
