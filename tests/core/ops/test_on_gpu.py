"""A GPU's kernels for training against plain torch, values and gradients: launched by a driver whose GPU is the CPU."""

from __future__ import annotations

import ctypes
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from analytic_scene import Stage, analytic_scene, drive_of, empty, ground, still
from driver_on_cpu import build_driver, loaded_driver, torch_on_driver
from ops import test_composite, test_hash_grid
from small_training import EVERYTHING, small_log
from torch import Tensor
from whole_drive import bound_to, whole_state

from unisim_blender.core import native
from unisim_blender.core.model.fields import query
from unisim_blender.core.model.networks import mlp, run_mlp
from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.ops import gpu
from unisim_blender.core.ops.encode import encode, encode_reference
from unisim_blender.core.ops.grid_shape import GridArrays, GridShape
from unisim_blender.core.ops.propose import RaySpans, Voxels, propose, propose_reference
from unisim_blender.core.ops.ray_segments import RayBatch
from unisim_blender.core.presets import preset
from unisim_blender.core.render.tracer import TraceResult, active_actors
from unisim_blender.core.render.tracers.torch.actor_tensors import active_actor_tensors
from unisim_blender.core.render.tracers.torch.segments import Sampling
from unisim_blender.core.render.tracers.torch.trace import trace
from unisim_blender.core.render.tracers.torch.tracer import TorchBackend, TorchTracer
from unisim_blender.core.training.on_device import DeviceTrainer

pytestmark = pytest.mark.skipif(shutil.which("g++") is None, reason="the driver is compiled by g++")
LAUNCHED = (
    "encode", "encode_table_gradient", "encode_point_gradient", "field", "intervals", "interval_gradients", "weigh",
    "sum_features", "weight_gradients", "gather_gradients", "feature_gradients", "propose_places",
)  # fmt: skip

SHAPES = {
    "hashed": GridShape.cubic((40.0, 24.0, 8.0), 3.2, 0.2, 6, 4, 11),
    "dense": GridShape.unit(4, 12, 3, 2, 12),
    "one feature": GridShape.unit(4, 64, 5, 1, 8),
}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_driver(tmp_path_factory.mktemp("driver"))


@pytest.fixture(autouse=True)
def driver(built: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ctypes.CDLL]:
    """Kernels are launched by a driver whose GPU is the CPU."""
    with loaded_driver(built, monkeypatch) as library, torch_on_driver(monkeypatch):
        yield library


def points(count: int, seed: int = 0) -> Tensor:
    """In the unit cube, on its faces, outside of it."""
    x = torch.rand(count, 3, generator=torch.Generator().manual_seed(seed)) * 1.2 - 0.1
    x[:3] = torch.tensor([[0.0, 0.5, 1.0], [1.0, 1.0, 1.0], [2.0, -3.0, 0.25]])
    return x


def close(got: Tensor, want: Tensor, share: float = 2e-6) -> None:
    assert got.shape == want.shape
    error = (got.double() - want.double()).abs().max()
    assert float(error) <= share * float(want.abs().max().clamp_min(1e-3)), float(error)


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("grids", [1, 3])
def test_encodings_and_their_gradients(name: str, grids: int) -> None:
    grid = GridArrays(SHAPES[name])
    generator = torch.Generator().manual_seed(1)
    table = torch.randn(grids, grid.rows, grid.shape.features, generator=generator)
    index = None if grids == 1 else torch.randint(grids, (150,), generator=generator)
    table, x = table if grids > 1 else table[0], points(150)
    given = torch.randn(150, grid.shape.width, generator=generator)
    found = []
    for kind, dtype in ((encode, torch.float32), (encode_reference, torch.float64)):
        t, p = (value.to(dtype, copy=True).requires_grad_() for value in (table, x))
        out = kind(grid, t, p, index)
        out.backward(given.to(dtype))
        assert t.grad is not None and p.grad is not None
        found.append((out.detach(), t.grad, p.grad))
    # a point at a cell's edge may fall to either side of it: the encoding is the same there, its slope is not
    near = (x.double()[:, None] * torch.tensor(grid.scale, dtype=torch.float64)).frac().abs()
    sure = ((near > 1e-4) & (near < 1 - 1e-4)).flatten(1).all(1) | (x <= 0).any(1)
    close(found[0][0], found[1][0], 1e-5)
    close(found[0][1], found[1][1], 1e-5)
    close(found[0][2][sure], found[1][2][sure], 2e-5)


def test_a_gradient_that_nobody_asks_for_is_not_worked_out() -> None:
    grid = GridArrays(SHAPES["dense"])
    table, x = torch.randn(grid.rows, 2, requires_grad=True), points(20)
    encode(grid, table, x).sum().backward()
    assert x.grad is None and table.grad is not None
    x, frozen = x.requires_grad_(), table.detach()
    encode(grid, frozen, x).sum().backward()
    assert x.grad is not None and frozen.grad is None


def test_nothing_is_nothing() -> None:
    grid = GridArrays(SHAPES["hashed"])
    table, network = torch.randn(grid.rows, 4), mlp(grid.shape.width, 16, 5)
    assert encode(grid, table, torch.empty(0, 3)).shape == (0, grid.shape.width)
    with torch.no_grad():
        assert query(grid, table, network, torch.empty(0, 3)).shape == (0, 5)


@pytest.mark.parametrize("outputs", [None, 1, 3])
@pytest.mark.parametrize("name", SHAPES)
def test_a_field_asked_in_one_go(name: str, outputs: int | None) -> None:
    grid = GridArrays(SHAPES[name])
    torch.manual_seed(2)
    table, network, x = torch.randn(2, grid.rows, grid.shape.features), mlp(grid.shape.width, 24, 20), points(100)
    x[5] = torch.nan
    index = torch.randint(2, (100,))
    with torch.no_grad():
        got = query(grid, table, network, x, index, outputs)
        code = encode_reference(grid, table.double(), x.double(), index)
        want = run_mlp(network.double(), code, outputs)
    close(got, want, 1e-5)


def test_places_of_samples() -> None:
    generator = torch.Generator().manual_seed(4)
    values = (torch.rand(20, 16, 8, generator=generator) < 0.15).to(torch.uint8)
    values = values * torch.randint(40, 256, values.shape, generator=generator).to(torch.uint8)
    voxels = Voxels(values, torch.tensor([-5.0, -4.0, 0.0]), 0.5)
    n, count = 90, 12
    o = torch.rand(n, 3, generator=generator) * torch.tensor([10.0, 8.0, 4.0]) + voxels.lower
    d = torch.nn.functional.normalize(torch.randn(n, 3, generator=generator), dim=-1)
    near, far = torch.full((n,), 0.1), torch.rand(n, generator=generator) * 12 + 0.2
    o[-2:] += 1e12  # far outside
    far[-4:-2] = 0  # and nothing to walk through
    u = ((torch.arange(count) + torch.rand(n, count, generator=generator)) / count).contiguous()
    t, mass = propose(voxels, RaySpans(o, d, near, far), u)
    want_t, want_mass = propose_reference(voxels, RaySpans(o, d, near, far), u)
    close(mass, want_mass, 1e-5)
    walked = far > near
    # a quantile at the end of a voxel may stand at the next one's beginning, behind free space
    apart = (t - want_t).abs()[walked] > 1e-3
    assert float(apart.float().mean()) < 0.01
    assert bool((mass[-4:] == 0).all()) and bool((mass > 0).sum() > n / 3)
    assert bool(torch.isfinite(t).all()) and bool((torch.diff(t[walked], dim=1) >= -1e-5).all())


def traced(seed: int) -> list[Tensor]:
    """What rays through a scene of random weights with an actor give, and gradients of it all."""
    torch.manual_seed(seed)
    drive = drive_of([still("car", [-12.0, 0.0, 1.6], [4.0, 3.0, 3.0])])
    scene = SceneModel(preset("tiny").model, analytic_scene(empty, {}).volume, ("car",), ("front",))
    with torch.no_grad():
        for field in (scene.static, scene.background):
            field.grid.table.normal_(0, 0.3)
        scene.occupancy.values.copy_((torch.rand(scene.occupancy.values.shape) < 0.3) * 255)
    directions = torch.nn.functional.normalize(torch.randn(48, 3) * 0.2 + torch.tensor([1.0, 0.0, 0.0]), dim=-1)
    eye = scene.frame.recentred(np.tile([-20.0, 0.0, 1.6], (48, 1)))
    active = active_actor_tensors(
        active_actors(whole_state(drive), {"": ("car",)}), {"": (scene, scene.actors.tables())}
    )
    rays = RayBatch(eye, directions, torch.zeros(48).double())
    found = trace(scene, active, rays, Sampling(jitter=True, generator=torch.Generator().manual_seed(2)))
    assert len(found.ray_segments) == 2
    outs = [found.feature, found.depth_m, found.opacity]
    sum(out.square().mean() for out in outs).backward()  # type: ignore[union-attr]
    names = (
        "static.grid.table",
        "background.grid.table",
        "actors.latents",
        "log_beta",
        "static.network.0.weight",
        "background.network.2.weight",
    )
    grads = [scene.get_parameter(name).grad for name in names]
    assert all(g is not None and bool((g != 0).any()) for g in grads)
    return [out.detach() for out in outs] + [g for g in grads if g is not None]


def test_rays_and_their_gradients_by_all_kernels_together(driver: ctypes.CDLL, monkeypatch: pytest.MonkeyPatch) -> None:
    by_kernels = traced(5)
    missing = [name for name in LAUNCHED if not driver.launches_of(f"unisim_{name}".encode()) and name != "field"]
    assert not missing
    monkeypatch.setattr(gpu, "serves", lambda like: False)
    for got, want in zip(by_kernels, traced(5), strict=True):
        close(got, want, 1e-3)


def test_structures_are_those_of_the_source(driver: ctypes.CDLL) -> None:
    assert ctypes.sizeof(gpu.EncodedPointsStruct) == driver.size_of_encoded_points()
    assert ctypes.sizeof(gpu.GatheredSegmentsStruct) == driver.size_of_gathered_segments()
    assert ctypes.sizeof(gpu.VoxelRaysStruct) == driver.size_of_voxel_rays()


OTHERS: dict[str, list[Callable[[], None]]] = {
    "values": [
        partial(test_hash_grid.test_values, name, count) for name in test_hash_grid.SHAPES for count in (0, 65, 1500)
    ],
    "gradients": [partial(test_hash_grid.test_gradients_of_every_width, features) for features in (1, 2, 4, 8)],
    "many grids": [test_hash_grid.test_many_grids_in_one_table],
    "sinks": [partial(test_hash_grid.test_a_sink_takes_the_tables_gradient, grids) for grids in (0, 3)],
    "intervals": [
        partial(test_composite.test_intervals, shape, beta)
        for shape in ((0, 12), (1, 1), (63, 2), (500, 12))
        for beta in (1.0, 20.0, 300.0)
    ],
    "no numbers": [partial(test_composite.test_what_is_not_a_number_stays_so, at) for at in (0, 4, 11)],
    "compositing": [
        partial(test_composite.test_values_and_gradients, groups)
        for groups in (test_composite.GROUPS, test_composite.GROUPS[:1], ((0, 4),))
    ],
}
"""Tests of the compiled kernels."""


@pytest.mark.parametrize("name", OTHERS)
def test_as_the_compiled_kernels(driver: ctypes.CDLL, name: str) -> None:
    for test in OTHERS[name]:
        test()
    assert any(driver.launches_of(f"unisim_{kernel}".encode()) for kernel in LAUNCHED)


@pytest.mark.parametrize("name", ["tiny", "small"])
def test_images_decoded_in_half_precision(name: str) -> None:
    """What a GPU does, by the CPU's own half precision: 8 bits are the same but for the last."""
    torch.manual_seed(6)
    stage = Stage(analytic_scene(ground, {}, preset(name).model), drive_of([]))
    with torch.no_grad():
        stage.scene.get_parameter("ray_head.codes").normal_()
        for p in stage.scene.camera_decoder.parameters():
            p.mul_(2.0)
    tracer = bound_to(TorchBackend(stage.as_scene()), stage.drive)
    n, directions = 24 * 16, np.tile([1.0, 0.0, 0.0], (24 * 16, 1))
    width = stage.scene.config.features
    nothing = torch.zeros(n)
    found = TraceResult(torch.randn(n, width), nothing, nothing, {}, [], [], None, None)
    plain = tracer.image(found, directions, "front", (16, 24))
    assert not tracer.half and plain.std() > 0.02
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TorchTracer, "half", True)
        half = tracer.image(found, directions, "front", (16, 24))
    assert half.dtype == np.float32 and 0 < np.abs(half - plain).max() < 1.5 / 255


def test_steps_of_a_training_are_those_of_plain_torch(
    driver: ctypes.CDLL, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, means = small_log(tmp_path / "log"), []
    monkeypatch.setattr(native, "library", lambda: None)
    for by_kernels in (True, False):
        monkeypatch.setattr(gpu, "serves", lambda like, on=by_kernels: on and like.dtype == torch.float32)
        trainer = DeviceTrainer(log, EVERYTHING)
        means.append([trainer.step() for _ in range(10)][-1])
    assert driver.launches_of(b"unisim_encode_table_gradient") > 20
    assert means[0].keys() == means[1].keys() and {"rgb", "eikonal", "lidar_m"} <= means[0].keys()
    for name, value in means[1].items():
        assert means[0][name] == pytest.approx(value, rel=0.02, abs=1e-5), name
