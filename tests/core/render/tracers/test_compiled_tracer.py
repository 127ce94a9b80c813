"""The compiled tracer beside torch's, on scenes of random weights: every field, configuration and pass."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analytic_scene import still
from instruction_sets import run_other
from numpy.typing import NDArray
from random_scene import CONFIGS, PASSES, TINY, edited, image_rays, saved
from whole_drive import bound_to

from unisim_bench.settings import VARIANTS
from unisim_blender.core import native
from unisim_blender.core.errors import SceneError, UnisimError
from unisim_blender.core.meshes.hits import MeshHits
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.render.quality import QUALITIES
from unisim_blender.core.render.tracer import Tracer, TraceResult, tiled
from unisim_blender.core.render.tracers.compiled import tracer as compiled_tracer
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.render.tracers.torch.tracer import TorchBackend
from unisim_blender.core.sensors.frames import RenderStats
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.world.drive import Appearance, Drive

needs_library = pytest.mark.skipif(native.library() is None, reason="the compiled kernels were not built")


def both_backends(
    folder: Path, quality: str = "reference", other: Path | None = None
) -> tuple[CompiledBackend, TorchBackend]:
    others = {} if other is None else {"other": other}
    return (
        CompiledBackend(
            CompiledScene(folder), QUALITIES[quality], {name: CompiledScene(path) for name, path in others.items()}
        ),
        TorchBackend(load_scene(folder), QUALITIES[quality], {name: load_scene(path) for name, path in others.items()}),
    )


def both(
    folder: Path, drive: Drive, quality: str = "reference", other: Path | None = None
) -> tuple[Tracer[Any], Tracer[Any]]:
    fast, slow = both_backends(folder, quality, other)
    return bound_to(fast, drive), bound_to(slow, drive)


def numbers(found: Any) -> NDArray[Any]:
    return np.asarray(found)


FEW = 2
"""So many rays of an image or a sweep may land in another voxel by rounding, or on the other side of a silhouette."""


def close(a: Any, b: Any, shape: tuple[int, ...], within: float) -> None:
    """All rays (h, w) agree, but for FEW: these see what the reference sees through one of their neighbours."""
    a, b = (numbers(x).astype(float).reshape(*shape, -1) for x in (a, b))
    assert not np.isnan(a).any() and not np.isnan(b).any()
    same = (np.isclose(a, b, rtol=within, atol=within) | (a == b)).all(-1)
    assert (~same).sum() <= FEW, (
        f"{(~same).sum()} rays of {same.size} differ, by {np.abs(a - b)[~same].max():.3g} at most"
    )
    for y, x in np.argwhere(~same):
        beside = b[max(0, y - 1) : y + 2, max(0, x - 1) : x + 2].reshape(-1, b.shape[-1])
        low, high = beside.min(0) - within, beside.max(0) + within
        assert ((a[y, x] >= low) & (a[y, x] <= high)).all(), (
            f"ray {y, x} is {a[y, x]}, its neighbours from {low} to {high}"
        )


def same_find(a: TraceResult[Any], b: TraceResult[Any], shape: tuple[int, ...], within: float = 2e-3) -> None:
    close(a.feature, b.feature, shape, within)
    close(a.opacity, b.opacity, shape, within)
    close(a.depth_m, b.depth_m, shape, 5 * within)
    assert a.maps.keys() == b.maps.keys()
    for name in a.maps:
        close(a.maps[name], b.maps[name], shape, 5 * within)
    for x, y in zip(
        (*a.foreign_features, *a.foreign_opacity, a.without_foreign, a.mesh_opacity),
        (*b.foreign_features, *b.foreign_opacity, b.without_foreign, b.mesh_opacity),
        strict=True,
    ):
        assert (x is None) == (y is None)
        if x is not None:
            close(x, y, shape, within)


def sweep_rays(drive: Drive) -> Rays:
    """A sweep from a little higher up: of one at 1.6 m a beam runs along the boxes' tops, where rounding
    decides who is met."""
    rays = lidar_rays(drive.lidars["top"], drive.lidars["top"].time_s[2])
    return Rays(rays.origins + [0, 0, 0.013], rays.directions, rays.time_s)


@needs_library
def test_no_rays_have_no_hits(tmp_path: Path) -> None:
    none = Rays(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    for tracer in both(saved(tmp_path / "scene", TINY), edited()):
        traced = tracer.trace(none, {"depth", "instance"}, True, None, RenderStats())
        assert {name: len(each) for name, each in traced.maps.items()} == {"depth": 0, "instance": 0}


def test_what_does_not_agree_is_seen() -> None:
    exact = np.arange(20.0).reshape(4, 5)
    close(exact.reshape(-1), exact + 1e-4, (4, 5), 1e-3)
    for place, value in (((1, 1), 7.5), ((1, 1), 5.0)):
        near = exact.copy()
        near[place] = value
        close(near, exact, (4, 5), 1e-3)
    for far in ({(1, 1): 13.0}, {(0, 0): 5.0, (1, 1): 7.0, (2, 2): 13.0}, {(3, 3): np.nan}, {(0, 0): -0.01}):
        wrong = exact.copy()
        for place, value in far.items():
            wrong[place] = value
        with pytest.raises(AssertionError):
            close(wrong, exact, (4, 5), 1e-3)


@needs_library
@pytest.mark.parametrize("name", CONFIGS)
@pytest.mark.parametrize("sky", (True, False))
def test_everything_that_is_recorded(tmp_path: Path, name: str, sky: bool) -> None:
    drive = edited()
    fast, slow = both(saved(tmp_path / "scene", CONFIGS[name]), drive)
    rays = image_rays(drive) if sky else sweep_rays(drive)
    shape = rays.time_s.shape
    stats = RenderStats(), RenderStats()
    found = fast.trace(rays, PASSES, sky, None, stats[0])
    expected = slow.trace(rays, PASSES, sky, None, stats[1])
    same_find(found, expected, shape)
    instances = np.unique(expected.maps["instance"])
    assert len(instances) > 2 and 0.1 < numbers(expected.opacity).mean() < 0.999
    assert stats[0].rays == stats[1].rays and stats[0].actors_skipped == stats[1].actors_skipped
    assert 0 < stats[0].samples_spent < 2 * stats[1].samples_spent
    if sky:
        images = [t.image(f, rays.flat().directions, "front", shape) for t, f in ((fast, found), (slow, expected))]
        close(images[0], images[1], images[1].shape[:2], 5e-3)
    else:
        for a, b in zip(
            fast.returns(found, rays.flat().directions), slow.returns(expected, rays.flat().directions), strict=True
        ):
            close(a, b, shape, 5e-3)


@needs_library
@pytest.mark.parametrize("meshes", (False, True))
def test_foreign_actors_and_meshes(tmp_path: Path, meshes: bool) -> None:
    drive = edited()
    foreign = still("guest", (-15, 0, 1.5), (3, 3, 3), yaw=0.3, appearance=Appearance("car", "other"))
    drive = dataclasses.replace(drive, actors={**drive.actors, "guest": foreign})
    wide = dataclasses.replace(TINY, features=7, upsample=1)
    fast, slow = both(saved(tmp_path / "scene", TINY), drive, other=saved(tmp_path / "other", wide, seed=1))
    rays = image_rays(drive)
    mesh_hits = None
    if meshes:
        rng = np.random.default_rng(0)
        ray = np.sort(rng.choice(rays.time_s.size, 200, replace=False))
        mesh_hits = MeshHits(
            ray,
            rng.uniform(3, 15, 200),
            rng.uniform(0.2, 1, 200),
            np.tile([0.0, 0, 1], (200, 1)),
            rng.integers(0, 2, 200),
        )
    found = fast.trace(rays, PASSES, True, mesh_hits, RenderStats())
    expected = slow.trace(rays, PASSES, True, mesh_hits, RenderStats())
    assert numbers(expected.foreign_opacity[0]).max() > 0.3
    shape = rays.time_s.shape
    same_find(found, expected, shape)
    images = [t.image(f, rays.flat().directions, "front", shape) for t, f in ((fast, found), (slow, expected))]
    close(images[0], images[1], images[1].shape[:2], 5e-3)
    returns = [t.returns(f, rays.flat().directions) for t, f in ((fast, found), (slow, expected))]
    close(returns[0][0], returns[1][0], shape, 5e-3)
    close(returns[0][1], returns[1][1], shape, 5e-3)


def bits(found: TraceResult[Any]) -> dict[str, NDArray[Any]]:
    return {"feature": found.feature, "depth_m": found.depth_m, "opacity": found.opacity, **found.maps}


@needs_library
def test_the_same_bits_with_any_threads_in_any_company(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drive = edited()
    tracer = bound_to(CompiledBackend(CompiledScene(saved(tmp_path / "scene", TINY))), drive)
    rays = image_rays(drive, up=1)
    whole = bits(tracer.trace(rays, PASSES, True, None, RenderStats()))
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    for name, values in bits(tracer.trace(rays, PASSES, True, None, RenderStats())).items():
        assert np.array_equal(values, whole[name]), name
    monkeypatch.setattr(compiled_tracer, "CHUNK_RAYS", 100)
    rows, columns = slice(3, 20), slice(11, 40)
    part = Rays(rays.origins[rows, columns], rays.directions[rows, columns], rays.time_s[rows, columns])
    for name, values in bits(tracer.trace(part, PASSES, True, None, RenderStats())).items():
        cut = whole[name].reshape(*rays.time_s.shape, -1)[rows, columns]
        assert np.array_equal(values.reshape(cut.shape), cut), name


@needs_library
@pytest.mark.parametrize("n", (0, 1, 16385))
def test_any_number_of_rays(tmp_path: Path, n: int) -> None:
    tracer = bound_to(CompiledBackend(CompiledScene(saved(tmp_path / "scene", TINY))), edited())
    angle = np.linspace(0, 2 * np.pi, n)
    directions = np.stack([np.cos(angle), np.sin(angle), -0.1 + 0 * angle], -1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = tracer.trace(
        Rays(np.tile([-20.0, 0, 1.6], (n, 1)), directions, np.full(n, 0.2)), PASSES, True, None, RenderStats()
    )
    for name, values in bits(found).items():
        assert len(values) == n and (name == "depth" or np.isfinite(values).all()), name


@needs_library
def test_nothing_is_made_that_was_not_asked_for(tmp_path: Path) -> None:
    drive = edited()
    tracer = bound_to(CompiledBackend(CompiledScene(saved(tmp_path / "scene", TINY))), drive)
    assert tracer.trace(image_rays(drive), set(), True, None, RenderStats()).maps == {}
    assert tracer.trace(image_rays(drive), {"depth"}, True, None, RenderStats()).maps.keys() == {"depth"}


def test_tiles_hold_every_ray_once() -> None:
    for shape in ((5,), (1, 1), (9, 17), (8, 16), (40, 3)):
        order = tiled(shape)
        assert np.array_equal(np.sort(order), np.arange(np.prod(shape)))
    assert set(tiled((16, 16))[:64].tolist()) == {16 * i + j for i in range(8) for j in range(8)}


@needs_library
def test_files_that_do_not_fit_are_named(tmp_path: Path) -> None:
    folder = saved(tmp_path / "scene", TINY)
    header = (folder / "scene.json").read_text()
    (folder / "scene.json").write_text(header.replace('"hidden": 32', '"hidden": 16'))
    with pytest.raises(SceneError, match=r"weights.safetensors: .*network.* has shape .*, scene.json asks for"):
        CompiledScene(folder)
    with pytest.raises(SceneError, match="nowhere"):
        CompiledScene(tmp_path / "nowhere")


def test_without_the_library_one_sentence_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "library", lambda: None)
    with pytest.raises(UnisimError, match="make setup"):
        CompiledScene(tmp_path)


VARIANT_SCRIPT = """
from pathlib import Path
from render.tracers import test_compiled_tracer as t
for name in ("tiny", "sample"):
    t.test_everything_that_is_recorded(Path(sys.argv[1]) / name, name, True)
t.test_foreign_actors_and_meshes(Path(sys.argv[1]) / "foreign", True)
from render.tracers import test_surface_march
test_surface_march.test_places_in_a_volume("balanced")
test_surface_march.test_places_in_a_box("balanced")
"""


@needs_library
@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant(name: str, tmp_path: Path) -> None:
    run_other(name, VARIANT_SCRIPT, tmp_path)
