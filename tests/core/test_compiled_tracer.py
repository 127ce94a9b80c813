"""The compiled tracer beside torch's, on scenes of random weights: every medium, configuration and pass."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from analytic_scene import drive_of, still
from numpy.typing import NDArray

from unisim_blender.core import native
from unisim_blender.core.compiled import tracer as compiled_tracer
from unisim_blender.core.compiled.scene import CompiledScene
from unisim_blender.core.compiled.tracer import CompiledTracer
from unisim_blender.core.drive import Box, Drive, Look, StaticCopy
from unisim_blender.core.errors import SceneError, UnisimError
from unisim_blender.core.fields.checkpoint import load_scene, save_scene
from unisim_blender.core.fields.config import GridConfig, ModelConfig, preset
from unisim_blender.core.fields.scene import SceneModel
from unisim_blender.core.fields.volume import Volume
from unisim_blender.core.frames import RenderStats
from unisim_blender.core.geometry import Trajectory, make_pose, quaternion_from_yaw
from unisim_blender.core.meshes.meeting import Met
from unisim_blender.core.scene_file import SceneHeader
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.torch_tracer import TorchTracer
from unisim_blender.core.tracer import Found, tiled

needs_library = pytest.mark.skipif(native.library() is None, reason="the compiled kernels were not built")
TINY = preset("tiny")
CONFIGS: dict[str, ModelConfig] = {
    "tiny": TINY,
    "dark": dataclasses.replace(TINY, light="fixed", features=31, hidden=64),
    "sample": dataclasses.replace(TINY, head="sample", static_grid=GridConfig(3.2, 0.1, 6, 2, 15)),
    "paper": dataclasses.replace(TINY, density="unisim", light="fixed", head="sample", unisim_step_m=0.5),
}
PASSES = {"depth", "instance", "normal", "opacity", "support"}
CARS = [
    still("car", (-8, 1, 0.8), (4.0, 1.8, 1.6), yaw=0.4),
    still("near", (-9, 0, 0.8), (4.0, 1.8, 1.6), yaw=-0.9),
    still("cone", (-12, -2, 0.4), (0.6, 0.6, 0.8)),
]
MOVING = dataclasses.replace(
    still("van", (-6, -3, 1), (5.0, 2.0, 2.2)),
    world_from_actor=Trajectory(
        np.array([0.0, 0.2, 0.5]),
        np.array([[-6.0, -3, 1], [-7, -1, 1], [-9, 2, 1]]),
        quaternion_from_yaw(np.array([0.0, 0.3, 1.0])),
    ),
    is_moving=True,
)


def box(x: float, y: float, z: float, yaw: float, size: tuple[float, float, float]) -> Box:
    return Box(make_pose(np.array([x, y, z]), quaternion_from_yaw(yaw)), np.array(size))


def edited() -> Drive:
    """A car gone, a box emptied, a place copied."""
    copies = (StaticCopy("copy", box(-5, 4, 1, 0.2, (3, 3, 3)), make_pose(np.array([-13.0, 3, 1.2]), quaternion_from_yaw(1.1))),)
    return drive_of([*CARS[1:], MOVING], copies, (box(-11, 1, 1, 0.5, (3, 2, 2)),))


def saved(folder: Path, config: ModelConfig, seed: int = 0) -> Path:
    """A scene with random weights, smooth enough to have surfaces, occupied here and there."""
    torch.manual_seed(seed)
    drive = drive_of([*CARS, MOVING])
    corner = make_pose(np.array([-30.0, -20.0, -4.0]), quaternion_from_yaw(0.1))
    model: Any = SceneModel(config, Volume(corner, np.array([60.0, 40.0, 16.0])), tuple(sorted(drive.actors)), ("front",))
    with torch.no_grad():
        for field in (model.static, model.far):
            rows = torch.linspace(2.0, 0.0, len(field.grid.table))[:, None]
            field.grid.table.copy_(torch.randn_like(field.grid.table) * rows)
        for parameter in model.actors.hypernetwork.parameters():
            parameter.normal_(0, 1.0)
        model.static.network[-1].bias[0] = -0.1
        model.actors.network[-1].bias[0] = -0.3
        if model.light is not None:
            model.light.network[-1].weight.normal_(0, 0.1)
            model.light.home.copy_(torch.rand(len(drive.actors), 3) * 10 + 20)
        model.ray_head.codes.normal_()
        model.occupancy.values.copy_(torch.where(torch.rand(model.occupancy.values.shape) < 0.03, 255, 0))
        model.observed.copy_(torch.rand(model.observed.shape) < 0.5)
        model.ground.heights.copy_(3.5 + torch.rand(model.ground.heights.shape))
    volume = model.volume.to_dict()
    training = {"frames": [0, 2], "cameras": ["front"], "lidars": ["top"], "width": None}
    header = SceneHeader(folder, "random", "none", "../none", np.zeros(3), config.to_dict(), volume, drive, training)
    save_scene(folder, header, model)
    return folder


def picture_rays(drive: Drive, up: int = 2) -> Rays:
    camera = drive.cameras["front"]
    return camera_rays(camera, 2, *pixel_grid(camera.model, up))


def both(folder: Path, drive: Drive, quality: str = "reference", other: Path | None = None) -> tuple[CompiledTracer, TorchTracer]:
    others = {} if other is None else {"other": other}
    return (
        CompiledTracer(CompiledScene(folder), drive, quality, {name: CompiledScene(path) for name, path in others.items()}),
        TorchTracer(load_scene(folder), drive, quality, {name: load_scene(path) for name, path in others.items()}),
    )


def numbers(found: Any) -> NDArray[Any]:
    return np.asarray(found)


def close(a: Any, b: Any, of: float, within: float) -> None:
    """Nearly all rays agree: a sample that rounding moves into the next voxel may differ."""
    a, b = numbers(a).astype(float), numbers(b).astype(float)
    assert a.shape == b.shape
    same = np.isclose(a, b, rtol=within, atol=within) | (a == b)
    same = same.reshape(len(same), -1).all(1)
    assert same.mean() >= of, f"{same.mean():.4f} agree, the others by {np.abs(a - b)[~same].max()}"


def same_find(a: Found, b: Found, of: float = 0.985, within: float = 2e-3) -> None:
    close(a.feature, b.feature, of, within)
    close(a.opacity, b.opacity, of, within)
    close(a.depth_m, b.depth_m, of, 5 * within)
    assert a.maps.keys() == b.maps.keys()
    for name in a.maps:
        close(a.maps[name], b.maps[name], of - 0.005, 5 * within)
    for x, y in zip(
        (*a.guest_features, *a.guest_opacity, a.without_guests, a.mesh_opacity),
        (*b.guest_features, *b.guest_opacity, b.without_guests, b.mesh_opacity),
        strict=True,
    ):
        assert (x is None) == (y is None)
        if x is not None:
            close(x, y, of, within)


@needs_library
@pytest.mark.parametrize("name", CONFIGS)
@pytest.mark.parametrize("sky", (True, False))
def test_everything_that_is_recorded(tmp_path: Path, name: str, sky: bool) -> None:
    drive = edited()
    fast, slow = both(saved(tmp_path / "scene", CONFIGS[name]), drive)
    rays = picture_rays(drive) if sky else lidar_rays(drive.lidars["top"], 2)
    stats = RenderStats(), RenderStats()
    found = fast.trace(rays, PASSES, sky, None, stats[0])
    expected = slow.trace(rays, PASSES, sky, None, stats[1])
    same_find(found, expected)
    instances = np.unique(expected.maps["instance"])
    assert len(instances) > 2 and 0.1 < numbers(expected.opacity).mean() < 0.999
    assert stats[0].rays == stats[1].rays and stats[0].actors_skipped == stats[1].actors_skipped
    assert 0 < stats[0].samples_spent < 2 * stats[1].samples_spent
    if sky:
        shape = rays.time_s.shape
        pictures = [t.image(f, rays.flat().directions, "front", shape) for t, f in ((fast, found), (slow, expected))]
        assert -10 * np.log10(np.square(pictures[0] - pictures[1]).mean()) > 45
    else:
        for a, b in zip(fast.returns(found, rays.flat().directions), slow.returns(expected, rays.flat().directions), strict=True):
            close(a, b, 0.98, 2e-3)


@needs_library
@pytest.mark.parametrize("meshes", (False, True))
def test_guests_and_meshes(tmp_path: Path, meshes: bool) -> None:
    drive = edited()
    guest = still("guest", (-15, 0, 1.5), (3, 3, 3), yaw=0.3, look=Look("car", "other"))
    drive = dataclasses.replace(drive, actors={**drive.actors, "guest": guest})
    wide = dataclasses.replace(TINY, features=7, upsample=1)
    fast, slow = both(saved(tmp_path / "scene", TINY), drive, other=saved(tmp_path / "other", wide, seed=1))
    rays = picture_rays(drive)
    met = None
    if meshes:
        rng = np.random.default_rng(0)
        ray = np.sort(rng.choice(rays.time_s.size, 200, replace=False))
        met = Met(ray, rng.uniform(3, 15, 200), rng.uniform(0.2, 1, 200), np.tile([0.0, 0, 1], (200, 1)), rng.integers(0, 2, 200))
    found = fast.trace(rays, PASSES, True, met, RenderStats())
    expected = slow.trace(rays, PASSES, True, met, RenderStats())
    assert numbers(expected.guest_opacity[0]).max() > 0.3
    same_find(found, expected)
    pictures = [t.image(f, rays.flat().directions, "front", rays.time_s.shape) for t, f in ((fast, found), (slow, expected))]
    assert -10 * np.log10(np.square(pictures[0] - pictures[1]).mean()) > 40
    returns = [t.returns(f, rays.flat().directions) for t, f in ((fast, found), (slow, expected))]
    close(returns[0][0], returns[1][0], 0.98, 5e-3)


def bits(found: Found) -> dict[str, NDArray[Any]]:
    return {"feature": found.feature, "depth_m": found.depth_m, "opacity": found.opacity, **found.maps}


@needs_library
def test_the_same_bits_with_any_threads_in_any_company(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drive = edited()
    tracer = CompiledTracer(CompiledScene(saved(tmp_path / "scene", TINY)), drive)
    rays = picture_rays(drive, up=1)
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
    tracer = CompiledTracer(CompiledScene(saved(tmp_path / "scene", TINY)), edited())
    angle = np.linspace(0, 2 * np.pi, n)
    directions = np.stack([np.cos(angle), np.sin(angle), -0.1 + 0 * angle], -1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = tracer.trace(Rays(np.tile([-20.0, 0, 1.6], (n, 1)), directions, np.full(n, 0.2)), PASSES, True, None, RenderStats())
    for name, values in bits(found).items():
        assert len(values) == n and (name == "depth" or np.isfinite(values).all()), name


@needs_library
def test_nothing_is_made_that_was_not_asked_for(tmp_path: Path) -> None:
    drive = edited()
    tracer = CompiledTracer(CompiledScene(saved(tmp_path / "scene", TINY)), drive)
    assert tracer.trace(picture_rays(drive), set(), True, None, RenderStats()).maps == {}
    assert tracer.trace(picture_rays(drive), {"depth"}, True, None, RenderStats()).maps.keys() == {"depth"}


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
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import test_compiled_tracer as t
from unisim_blender.core import native
assert native.variant() == sys.argv[2], native.variant()
for name in ("tiny", "sample"):
    t.test_everything_that_is_recorded(Path(sys.argv[3]) / name, name, True)
t.test_guests_and_meshes(Path(sys.argv[3]) / "guests", True)
import test_surface_march
test_surface_march.test_places_in_a_volume("balanced")
test_surface_march.test_places_in_a_box("balanced")
"""


@needs_library
@pytest.mark.parametrize("variant", ("portable", "avx2", "avx512"))
def test_instruction_sets(variant: str, tmp_path: Path) -> None:
    environment = {**os.environ, "UNISIM_NATIVE_VARIANT": variant}
    asked = [sys.executable, "-c", "from unisim_blender.core import native; print(native.variant())"]
    if subprocess.run(asked, env=environment, capture_output=True, text=True, timeout=60).stdout.strip() != variant:
        pytest.skip(f"this processor or build has no {variant}")
    script = [sys.executable, "-c", VARIANT_SCRIPT, str(Path(__file__).parent), variant, str(tmp_path)]
    done = subprocess.run(script, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
