"""The march to surfaces: the kernels beside the plain reference, the reference beside known geometry, the
tracer beside truth."""

from __future__ import annotations

import ctypes
import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from random_scene import CONFIGS, edited, image_rays, saved
from surface_march import (
    BOX_CELLS,
    CELLS,
    OPEN,
    POINTS,
    REACH,
    SOLID,
    SURFACE,
    ActorBox,
    Before,
    Floats,
    Kinds,
    Sample,
    Steps,
    Volume,
    kinds_in_grid,
    kinds_of,
    march,
    runs_in_box,
    runs_in_volume,
    unpacked,
)  # fmt: skip
from whole_drive import bound_to

from unisim_blender.core import native
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.ops.density import logistic_intervals
from unisim_blender.core.ops.transmittances import weights_from_tau
from unisim_blender.core.render.quality import QUALITIES, Quality
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.structs import SamplingStruct, address, floats
from unisim_blender.core.render.tracers.compiled.tracer import (
    MIN_SLOPE,
    MIN_SPLIT_WEIGHT,
    MIN_STEP_M,
    STEP_GROWTH_PER_M,
    CompiledBackend,
    CompiledTracer,
)
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.frames import RenderStats
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sensors.rays import Rays

needs_library = pytest.mark.skipif(native.library() is None, reason="the compiled kernels were not built")

VOXEL_M = 0.5
SIZE_M = np.array([40.0, 10.0, 6.0])
BETA = 80.0
Space = Callable[[NDArray[Any]], NDArray[Any]]
"""Signed distances (N,) in metres at points (N, 3)."""


def steps_of(quality: Quality) -> Steps:
    return Steps(
        quality.opaque,
        quality.stride_m,
        STEP_GROWTH_PER_M,
        quality.relaxation,
        MIN_SLOPE,
        MIN_STEP_M,
        quality.splits,
        MIN_SPLIT_WEIGHT,
    )


STEPS = {name: steps_of(QUALITIES[name]) for name in ("fast", "balanced", "fine")}


def grid(shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Middles (N, 3) of unit cells."""
    return np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in shape), indexing="ij"), -1).reshape(-1, 3)


def volume_of(space: Space, size_m: NDArray[Any] = SIZE_M) -> Volume:
    """The cells of a volume in which every voxel is known."""
    gap = VOXEL_M / (CELLS * POINTS)
    shape = tuple((size_m / gap).astype(int))
    return Volume(kinds_in_grid(kinds_of(space(grid(shape) * gap).reshape(shape).astype(np.float32), gap)), VOXEL_M)


def along(space: Space, origin: Any, direction: Any) -> Callable[[np.float32], float]:
    o, d = np.asarray(origin, float), np.asarray(direction, float)
    return lambda t: float(space((o + float(t) * d)[None])[0])


def unit(*direction: float) -> NDArray[np.float64]:
    d = np.array(direction)
    return d / np.linalg.norm(d)


def seen(
    space: Space,
    origin: Any,
    direction: Any,
    how: Steps,
    t_far: float = 35.0,
    volume: Volume | None = None,
    **cleared: Any,
) -> tuple[float, float, list[Sample]]:
    """Mean depth and opacity of a ray through a space, and its samples."""
    o, d = np.asarray(origin, np.float32), np.asarray(direction, np.float32)
    runs = runs_in_volume(volume or volume_of(space), o, d, 0.05, t_far, **cleared)
    samples = march(runs, along(space, o, d), BETA, how)
    return *composited(samples), samples


def composited(samples: list[Sample]) -> tuple[float, float]:
    """Mean depth and opacity of samples, as `composite.py` has them."""
    if not samples:
        return np.inf, 0.0
    t, s = (torch.tensor([float(getattr(p, name)) for p in samples], dtype=torch.float64)[None] for name in ("t", "s"))
    tau, share = logistic_intervals(s, BETA)
    front, behind = weights_from_tau(tau)
    whole, far = front * -torch.expm1(-tau), front * share
    weight = far.clone()
    weight[:, :-1] += (whole - far)[:, 1:]
    weight[:, 0] += whole[:, 0]
    return float((weight * t).sum() / weight.sum().clamp_min(1e-9)), 1 - float(behind)


def plate(low: Any, high: Any) -> Space:
    """A block between two corners."""
    a, b = np.asarray(low, float), np.asarray(high, float)

    def distance(x: NDArray[Any]) -> NDArray[Any]:
        q = np.abs(x - (a + b) / 2) - (b - a) / 2
        return np.linalg.norm(q.clip(0), axis=-1) + q.max(-1).clip(max=0)

    return distance


def pole(x: float, y: float, radius: float) -> Space:
    return lambda p: np.hypot(p[:, 0] - x, p[:, 1] - y) - radius


def bumps(seed: int, waves_a_metre: float = 1.2) -> Space:
    """A smooth random space, a quarter of it solid."""
    rng = np.random.default_rng(seed)
    waves, phases = rng.normal(0, waves_a_metre, (12, 3)), rng.uniform(0, 2 * np.pi, 12)
    return lambda x: 0.25 + 0.12 * np.cos(x @ waves.T + phases).sum(-1)


def moved(space: Space, by_m: float) -> Space:
    """The same surfaces farther away."""
    return lambda x: space(x) + by_m


def random_rays(seed: int, n: int, size_m: NDArray[Any]) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(seed)
    directions = rng.normal(0, 1, (n, 3))
    directions[::7, 1] = 0
    return floats(rng.uniform(0.1, 0.9, (n, 3)) * size_m), floats(
        directions / np.linalg.norm(directions, axis=1, keepdims=True)
    )


class Kernel:
    """The compiled march, through a volume or a box."""

    def __init__(self, where: Volume | ActorBox, beta: float = BETA, voxels: Kinds | None = None) -> None:
        library = native.library()
        assert library is not None
        self.library, self.in_box = library, isinstance(where, ActorBox)
        self.struct = native.SceneStruct(beta=beta)
        self.kept: list[Any] = []
        if isinstance(where, ActorBox):
            self.kept.append(np.ascontiguousarray(where.kinds))
            self.struct.box_cells, self.struct.size = address(self.kept[0]), (ctypes.c_float * 3)(*where.size_m)
            return
        shape = np.array(where.kinds.shape, np.int32) // CELLS
        x, y, z = shape
        parts = where.kinds.reshape(x, CELLS, y, CELLS, z, CELLS).transpose(0, 2, 4, 1, 3, 5).reshape(x, y, z, CELLS**3)
        words = (parts.astype(np.uint16) << (2 * np.arange(CELLS**3, dtype=np.uint16))).sum(-1).astype(np.uint16)
        assert np.array_equal(unpacked(words), where.kinds)
        clearance = np.empty(words.shape, np.uint8)
        closed = (words > 0).astype(np.uint8)
        library.unisim_clearance(address(closed), address(shape), address(clearance))
        self.kept += [words, clearance]
        # without free voxels before them, samples have no face
        known = np.zeros(words.shape, np.uint8) if voxels is None else np.ascontiguousarray(voxels)
        self.kept.append(known)
        self.struct.voxels = address(known)
        self.struct.cells, self.struct.clearance = address(words), address(clearance)
        self.struct.voxel_shape, self.struct.voxel_m = (ctypes.c_int32 * 3)(*shape), where.voxel_m

    def march(
        self, origins: Floats, directions: Floats, spans: Floats, distances: list[Callable[[np.float32], float]],
        how: Steps,
        cleared: Floats | None = None, passed: Floats | None = None,
    ) -> list[NDArray[np.float64]]:  # fmt: skip
        """Samples (K, 2), t and s, of each ray; ``distances`` are their signed distances by t."""
        n, capacity = len(origins), 4096
        cleared = floats(np.tile([np.inf, -np.inf], (n, 1))) if cleared is None else cleared
        passed = floats(np.zeros(n)) if passed is None else passed
        t, s, counts = np.empty((n, capacity), np.float32), np.empty((n, capacity), np.float32), np.empty(n, np.int32)
        names = {field.name for field in dataclasses.fields(Steps)}
        sampling = SamplingStruct(**{name: getattr(how, name) for name in names})
        distance = ctypes.CFUNCTYPE(ctypes.c_float, ctypes.c_int64, ctypes.c_float)(
            lambda i, t: distances[i](np.float32(t))
        )
        self.library.unisim_march(
            ctypes.byref(self.struct), int(self.in_box), *map(address, (origins, directions, spans, cleared, passed)),
            n,
            ctypes.byref(sampling), distance, capacity, *map(address, (t, s, counts)),
        )  # fmt: skip
        assert (counts <= capacity).all()
        return [np.stack([t[i, :k], s[i, :k]], -1).astype(float) for i, k in enumerate(counts)]


def is_same(found: NDArray[Any], expected: list[Sample]) -> bool:
    b = np.array([(p.t, p.s) for p in expected], float).reshape(-1, 2)
    return found.shape == b.shape and bool(np.allclose(found, b, rtol=0, atol=1e-3))


def same_places(found: list[NDArray[Any]], expected: list[list[Sample]]) -> None:
    """Nearly all rays have samples at the same places: rounding may decide otherwise where a number lies on a limit."""
    same = sum(is_same(a, b) for a, b in zip(found, expected, strict=True))
    assert same >= 0.985 * len(found), f"{same} of {len(found)}"
    assert np.mean([len(a) > 0 for a in found]) > 0.3 and max(map(len, found)) > 8


@needs_library
@pytest.mark.parametrize("name", STEPS)
def test_places_in_a_volume(name: str) -> None:
    space, size, n = bumps(0), np.array([20.0, 12.0, 8.0]), 90
    # much is solid, for emptied boxes to open
    volume = volume_of(moved(space, -0.3), size)
    assert {OPEN, SOLID, SURFACE} == set(np.unique(volume.kinds))
    # a part that nobody knows is free
    volume.kinds[:12] = OPEN
    origins, directions = random_rays(1, n, size)
    rng = np.random.default_rng(2)
    spans = floats(np.stack([rng.uniform(0, 1, n), rng.uniform(-1, 25, n)], -1))
    cleared = floats(np.where(np.arange(n)[:, None] % 2, np.sort(rng.uniform(0, 6, (n, 2))), [np.inf, -np.inf]))
    passed = floats(np.where(np.arange(n) % 3, 0, rng.uniform(0, 9, n)))
    # every other pair of rays is stopped by nothing, and meets all of its runs
    distances = [along(moved(space, 0.4 * (i // 2 % 2)), origins[i], directions[i]) for i in range(n)]
    voxels = (rng.random(np.array(volume.kinds.shape) // CELLS) < 0.3).astype(np.uint8)
    found = Kernel(volume, voxels=voxels).march(origins, directions, spans, distances, STEPS[name], cleared, passed)

    def before(i: int) -> Before:
        def occupied(t: np.float32) -> bool:
            x = ((origins[i] + t * directions[i]) / np.float32(VOXEL_M)).clip(0, np.array(voxels.shape) - 1)
            return bool(voxels[tuple(x.astype(int))])

        return Before(VOXEL_M, spans[i, 0], occupied)

    expected = [
        march(
            runs_in_volume(volume, origins[i], directions[i], spans[i, 0], spans[i, 1], (cleared[i, 0], cleared[i, 1])),
            distances[i], BETA, STEPS[name], float(passed[i]), before(i),
        )
        for i in range(n)
    ]  # fmt: skip
    assert sum(sample.after_free for samples in expected for sample in samples[1:]) > 5
    same_places(found, expected)


@needs_library
@pytest.mark.parametrize("name", STEPS)
def test_places_in_a_box(name: str) -> None:
    space, size, n = bumps(3, 3.0), np.array([4.0, 2.0, 1.5]), 200
    points = grid((BOX_CELLS * POINTS,) * 3) / (BOX_CELLS * POINTS) - 0.5
    s = space(points * size).reshape((BOX_CELLS * POINTS,) * 3)
    box = ActorBox(
        kinds_in_grid(kinds_of(s.astype(np.float32), float(size.max()) / (BOX_CELLS * POINTS))), floats(size)
    )
    assert SURFACE in box.kinds
    origins, directions = random_rays(4, n, size)
    origins -= floats(size / 2)
    spans = floats(np.stack([np.full(n, -2.0), np.random.default_rng(5).uniform(-2.5, 3, n)], -1))
    distances = [along(space, o, d) for o, d in zip(origins, directions, strict=True)]
    found = Kernel(box).march(origins, directions, spans, distances, STEPS[name])
    expected = [
        march(runs_in_box(box, origins[i], directions[i], *spans[i]), distances[i], BETA, STEPS[name]) for i in range(n)
    ]
    same_places(found, expected)


@needs_library
def test_rays_of_any_numbers_end() -> None:
    space = plate((20, -1, -1), (41, 11, 7))
    volume, kernel = volume_of(space), Kernel(volume_of(space))
    rays: list[tuple[tuple[float, ...], tuple[float, ...], tuple[float, float], bool]] = [
        ((1, 5, 3), (1, 0, 0), (0, np.inf), True),
        ((1, 5, 3), (1, 0, 0), (-np.inf, 30), False),
        ((1, 5, 3), (1, 0, 0), (1e10, 2e10), False),
        ((1, 5, 3), (-1, 0, 0), (0, 1e12), False),
        ((1, 5, 3), (0, 0, 0), (0, 1e11), False),
        ((1, 5, 3), (np.nan, 0, 0), (0, 30), False),
        ((np.nan, 5, 3), (1, 0, 0), (0, 30), False),
        ((1, 5, 3), (1, 0, 0), (np.nan, 30), False),
        ((-100, 5, 3), (1, 0, 0), (0, 200), True),
        ((1, 5, 50), (1, 0, 0), (0, 30), False),
        ((1, 5, 3), (1, 0, 0), (30, 1), False),
    ]
    for origin, direction, span, meets in rays:
        o, d = floats(origin), floats(direction)
        distance = along(space, o, d)
        found = kernel.march(o[None], d[None], floats([span]), [distance], STEPS["balanced"])
        with np.errstate(all="ignore"):
            runs = runs_in_volume(volume, o, d, *span)
        expected = march(runs, distance, BETA, STEPS["balanced"])
        assert (len(found[0]) > 0) == (len(expected) > 0) == meets, (origin, direction, span)
        if meets:
            assert is_same(found[0], expected)
    # distances that are no numbers, and surfaces as blurred as they can be
    start, ahead, spans = floats([[1, 5, 3]]), floats([[1, 0, 0]]), floats([[0, 35]])
    assert len(kernel.march(start, ahead, spans, [lambda t: np.nan], STEPS["fine"])[0]) == 1
    for beta in (1e-6, 1e-2, 10.0, 1e4):
        blurred = Kernel(volume, beta).march(start, ahead, spans, [lambda t: 1e-3], STEPS["fine"])[0]
        expected = march(runs_in_volume(volume, start[0], ahead[0], 0, 35), lambda t: 1e-3, beta, STEPS["fine"])
        assert 0 < len(blurred) < 500
        assert is_same(blurred, expected)


def limits_are_near(s: Floats, gap_m: float) -> NDArray[np.bool_]:
    """Cells that rounding may make others, by distances s as in `kinds_of`, and those beside them."""
    shape = [n // POINTS for n in s.shape]
    points, reach = s.reshape(shape[0], POINTS, shape[1], POINTS, shape[2], POINTS), float(REACH) * gap_m
    near = np.minimum(np.abs(points.min((1, 3, 5)) - reach), np.abs(points.max((1, 3, 5)) + reach)) < 1e-4
    padded = np.pad(near, 1)
    x, y, z = near.shape
    return np.any([padded[a : a + x, b : b + y, c : c + z] for a in range(3) for b in range(3) for c in range(3)], 0)


def same_cells(found: Kinds, expected: Kinds, doubtful: NDArray[np.bool_]) -> None:
    assert doubtful.mean() < 0.02
    assert np.array_equal(found[~doubtful], expected[~doubtful])
    assert {OPEN, SOLID, SURFACE} <= set(np.unique(found))


@needs_library
@pytest.mark.parametrize("name", ("tiny", "sample"))
def test_cells_of_random_scenes(tmp_path: Path, name: str) -> None:
    library = native.library()
    assert library is not None
    folder = saved(tmp_path / "scene", CONFIGS[name])
    scene, model = CompiledScene(folder), load_scene(folder).model
    shape, voxel, side = tuple(scene.struct.voxel_shape), scene.config.voxel_m, CELLS * POINTS
    gap = voxel / side
    numbers = np.arange(np.prod(shape), dtype=np.int64).reshape(shape)
    known = np.ascontiguousarray(numbers[10:22, 20:32, -8:].reshape(-1)[::-1])
    words = np.zeros(shape, np.uint16)
    library.unisim_cells(ctypes.byref(scene.struct), address(known), len(known), address(words), 1)
    corners = np.stack(np.unravel_index(known, shape), -1)
    places = (corners[:, None] * voxel + grid((side,) * 3) * gap).reshape(-1, 3)
    with torch.no_grad():
        s_at = model.static.signed_distance(torch.tensor(places, dtype=torch.float32)).numpy()
    # what nobody knows is open
    s = np.full((24, 40, shape[2], side, side, side), 1e3, np.float32)
    s[tuple(corners.T)] = s_at.reshape(-1, side, side, side)
    s = s.transpose(0, 3, 1, 4, 2, 5).reshape(24 * side, 40 * side, shape[2] * side)
    assert not words[24:].any() and not words[:, 40:].any()
    same_cells(unpacked(words[:24, :40]), kinds_in_grid(kinds_of(s, gap)), limits_are_near(s, gap))


@needs_library
def test_cells_of_random_actors(tmp_path: Path) -> None:
    library = native.library()
    assert library is not None
    folder = saved(tmp_path / "scene", CONFIGS["tiny"])
    scene, loaded = CompiledScene(folder), load_scene(folder)
    side, count = BOX_CELLS * POINTS, len(scene.appearances)
    sizes = floats([scene.header.drive.actors[uid].size_m for uid in scene.appearances])
    kinds = np.empty((count, BOX_CELLS, BOX_CELLS, BOX_CELLS), np.uint8)
    library.unisim_box_cells(ctypes.byref(scene.struct), address(sizes), count, address(kinds), 1)
    places = torch.tensor(grid((side,) * 3) / side, dtype=torch.float32)
    for row in range(count):
        with torch.no_grad():
            s_at = loaded.model.actors.signed_distance(loaded.actor_tables, places, torch.full((len(places),), row))
        s, gap = s_at.numpy().reshape(side, side, side), float(sizes[row].max()) / side
        same_cells(kinds[row], kinds_in_grid(kinds_of(s, gap)), limits_are_near(s, gap))


def test_a_solid_cell_beside_an_open_one_is_a_surface() -> None:
    kinds = np.full((5, 5, 5), SOLID, np.uint8)
    kinds[2, 2, 2] = OPEN
    after = kinds_in_grid(kinds)
    assert after[2, 2, 2] == OPEN
    # the border is beside what lies outside
    assert (after == SURFACE).sum() == 124
    inner = kinds_in_grid(np.full((7, 7, 7), SOLID, np.uint8))
    assert (inner[1:-1, 1:-1, 1:-1] == SOLID).all() and (inner == SURFACE).sum() == 7**3 - 5**3


@pytest.mark.parametrize("name", STEPS)
def test_a_wall_head_on(name: str) -> None:
    space = plate((20, -1, -1), (41, 11, 7))
    for y in (3.1, 4.9):
        depth, opacity, samples = seen(space, (1, y, 3.3), (1, 0, 0), STEPS[name])
        assert abs(depth - 19) < 0.003 and opacity > 1 - 2 * STEPS[name].opaque and len(samples) <= 9


@pytest.mark.parametrize("name", STEPS)
def test_the_ground_at_one_degree(name: str) -> None:
    def ground(x: NDArray[Any]) -> NDArray[Any]:
        return x[:, 2] - 1.0

    angle = np.radians(1.0)
    depth, opacity, samples = seen(ground, (1, 5, 1.5), (np.cos(angle), 0, -np.sin(angle)), STEPS[name], t_far=38.0)
    assert abs(depth - 0.5 / np.sin(angle)) < 0.06 and opacity > 0.98 and len(samples) <= 100


def test_a_pole_of_five_centimetres_at_thirty_metres() -> None:
    space, rng = pole(31.0, 5.0, 0.025), np.random.default_rng(0)
    volume = volume_of(space)
    missed = dict.fromkeys(STEPS, 0)
    n = 60
    for _ in range(n):
        origin = np.array([1.0, 5 + rng.uniform(-1, 1), 3 + rng.uniform(-1, 1)])
        aim = unit(*(np.array([31.0, 5 + rng.uniform(-0.02, 0.02), 3.0]) - origin))
        truth = seen(
            space, origin, aim, dataclasses.replace(STEPS["fine"], stride_m=0.004, relaxation=0.1), volume=volume
        )
        assert truth[1] > 0.5
        for name, how in STEPS.items():
            depth, opacity, _ = seen(space, origin, aim, how, volume=volume)
            missed[name] += opacity < 0.5 * truth[1] or abs(depth - truth[0]) > 0.1
    assert not any(missed.values()), missed


def test_two_walls() -> None:
    near, far = plate((10, -1, -1), (10.3, 11, 3)), plate((20, -1, -1), (21, 11, 7))

    def space(x: NDArray[Any]) -> NDArray[Any]:
        return np.minimum(near(x), far(x))

    volume = volume_of(space)
    for name, how in STEPS.items():
        for height, expected in ((1.5, 9), (2.9, 9), (3.12, 19), (4.5, 19)):
            depth, opacity, _ = seen(space, (1, 5, height), (1, 0, 0), how, volume=volume)
            assert abs(depth - expected) < 0.02 and opacity > 0.98, (name, height, depth)


@pytest.mark.parametrize("name", STEPS)
def test_a_ray_that_starts_inside(name: str) -> None:
    space = plate((0.5, 4, 2), (3, 6, 4))
    # 30 cm behind the surface, in a solid cell: the first that counts is met at once
    depth, opacity, samples = seen(space, (2.7, 5, 3), (1, 0, 0), STEPS[name])
    assert depth < 0.06 and opacity > 0.98 and len(samples) == 1


def test_solid_cells_count_where_a_box_was_emptied() -> None:
    # all behind x = 5 is solid; a box from 12 to 18 was emptied
    rock, box = plate((5, -1, -1), (41, 11, 7)), (11.0, 17.0)

    def space(x: NDArray[Any]) -> NDArray[Any]:
        cleared = (x[:, 0] > 12) & (x[:, 0] < 18)
        return np.where(cleared, np.maximum(rock(x), 3.0), rock(x))

    volume = volume_of(rock)
    for how in STEPS.values():
        origin = np.array([13.0, 5, 3])
        runs = [
            runs_in_volume(volume, floats(origin), floats([1, 0, 0]), 0, 20, cleared)
            for cleared in ((-1.0, 5.0), (9.0, -9.0))
        ]
        samples = march(runs[0], along(space, origin, (1, 0, 0)), BETA, how)
        # the box's end is no surface of the distance: it is found to a step
        assert abs(composited(samples)[0] - 5) < 0.4 and composited(samples)[1] > 0.98
        assert len(runs[1]) == 0 or runs[1][0][0] > 20
        whole = seen(space, (1, 5, 3), (1, 0, 0), how, volume=volume, cleared=box)
        assert abs(whole[0] - 4) < 0.01 and whole[1] > 0.98


def test_where_nothing_is_nothing_is_asked() -> None:
    def empty(x: NDArray[Any]) -> NDArray[Any]:
        return np.full(len(x), 9.0)

    for how in STEPS.values():
        assert seen(empty, (1, 5, 3), (1, 0, 0), how)[2] == []


SAMPLE = Path(__file__).parents[4] / "sample" / "scene"


@dataclasses.dataclass
class Appearance:
    """Rays of a sensor through the sample scene, and what there is to see."""

    tracer: CompiledTracer
    rays: Rays
    sky: bool

    def at(self, quality: Quality) -> tuple[NDArray[Any], NDArray[Any], float]:
        """Picture (LiDAR: the features in its place), median depths, samples a ray."""
        self.tracer.quality, stats = quality, RenderStats()
        found = self.tracer.trace(self.rays, {"depth"}, self.sky, None, stats)
        directions, shape = self.rays.flat().directions, self.rays.time_s.shape
        image = self.tracer.image(found, directions, "front_camera", shape) if self.sky else found.feature
        return image, found.maps["depth"], stats.samples_spent / stats.rays


@pytest.fixture(scope="module")
def appearances() -> dict[str, Appearance]:
    scene = CompiledScene(SAMPLE)
    drive = scene.header.drive
    tracer, camera = bound_to(CompiledBackend(scene), drive), drive.cameras["front_camera"]
    camera = dataclasses.replace(camera, model=camera.model.resized(96))
    sweep = lidar_rays(drive.lidars["pandar64"], drive.lidars["pandar64"].time_s[4])
    some = slice(None, None, 60)
    columns = Rays(sweep.origins[:, some], sweep.directions[:, some], sweep.time_s[:, some])
    image = camera_rays(camera, camera.time_s[4], *pixel_grid(camera.model, scene.config.upsample))
    return {"camera": Appearance(tracer, image, True), "lidar": Appearance(tracer, columns, False)}


def psnr(a: NDArray[Any], b: NDArray[Any]) -> float:
    return float(-10 * np.log10(np.square(a - b).mean()))


BOUNDS = {
    "camera": {
        "fast": (37.5, 8e-4, 0.035, 0.035, 17.0),
        "balanced": (39.5, 4e-4, 0.022, 0.025, 21.0),
        "fine": (42.5, 2.5e-4, 0.012, 0.019, 42.0),
    },
    "lidar": {
        "fast": (29.5, 6e-4, 0.02, 0.022, 12.0),
        "balanced": (30.0, 4e-4, 0.016, 0.018, 15.0),
        "fine": (31.5, 2e-4, 0.013, 0.012, 24.0),
    },
}
"""By sensor and quality: the least PSNR, in dB, and the largest median and 95th percentile of the depth's error, in
metres, share of rays whose depth is off by more than 0.1 m, and samples a ray."""


@needs_library
@pytest.mark.parametrize("sensor", ("camera", "lidar"))
def test_qualities_beside_the_truth(appearances: dict[str, Appearance], sensor: str) -> None:
    appearance = appearances[sensor]
    metrics: list[NDArray[np.float64]] = []
    for name, (least_psnr, median, p95, coarse, samples) in BOUNDS[sensor].items():
        quality = QUALITIES[name]
        # the background has so many samples that both sums are the integral
        truth = appearance.at(dataclasses.replace(QUALITIES["reference"], samples=16.0, background=8.0))
        found = appearance.at(dataclasses.replace(quality, background=8.0))
        hit = np.isfinite(truth[1])
        assert (np.isfinite(found[1]) == hit).mean() > 0.998
        both = hit & np.isfinite(found[1])
        error = np.abs(found[1][both] - truth[1][both])
        metrics.append(np.array([-psnr(found[0], truth[0]), *np.quantile(error, (0.5, 0.95)), (error > 0.1).mean()]))
        spent = appearance.at(quality)[2]
        assert (metrics[-1] < (-least_psnr, median, p95, coarse)).all() and spent < samples, (name, metrics[-1], spent)
    for worse, better in itertools.pairwise(metrics):
        assert (better < worse).all()


@needs_library
def test_every_field_beside_the_quantiles(tmp_path: Path) -> None:
    """Actors that overlap, an emptied box and a copy, on fields of random weights, which are rougher than
    any trained one."""
    drive = edited()
    tracer = bound_to(CompiledBackend(CompiledScene(saved(tmp_path / "scene", CONFIGS["tiny"]))), drive)
    rays = image_rays(drive)
    found = {}
    for name, quality in (
        ("truth", dataclasses.replace(QUALITIES["reference"], samples=16.0)),
        ("fine", QUALITIES["fine"]),
    ):
        tracer.quality = dataclasses.replace(quality, background=1.0)
        found[name] = tracer.trace(rays, {"instance"}, True, None, RenderStats())
    a, b = found["fine"], found["truth"]
    assert (a.maps["instance"] == b.maps["instance"]).mean() > 0.985 and len(np.unique(b.maps["instance"])) > 2
    assert (np.abs(a.opacity - b.opacity) < 0.1).mean() > 0.88 and 0.1 < b.opacity.mean() < 0.999
    # features are 0.25 in the mean
    assert np.median(np.abs(a.feature - b.feature)) < 0.03
