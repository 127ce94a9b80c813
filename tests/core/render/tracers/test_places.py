"""Places of samples by the compiled kernels beside those of plain torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from analytic_scene import analytic_scene, drive_of, empty, still
from torch import Tensor
from whole_drive import whole_state

from unisim_blender.core import native
from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.ops.ray_segments import RayBatch
from unisim_blender.core.ops.segment_trace import SegmentTrace
from unisim_blender.core.presets import preset
from unisim_blender.core.render.tracer import active_actors
from unisim_blender.core.render.tracers.torch import places, segments
from unisim_blender.core.render.tracers.torch.actor_tensors import active_actor_tensors
from unisim_blender.core.render.tracers.torch.segments import Sampling
from unisim_blender.core.render.tracers.torch.trace import trace

pytestmark = pytest.mark.skipif(native.library() is None, reason="the compiled kernels are not built")

RAYS = 300


@pytest.fixture
def scene() -> SceneModel:
    """Bumps of some metres in voxels that are half free, on uneven ground."""
    torch.manual_seed(1)
    scene = SceneModel(preset("tiny").model, analytic_scene(empty, {}).volume, ("car",), ("front",))
    with torch.no_grad():
        scene.static.grid.table.uniform_(-1, 1)
        scene.background.grid.table.uniform_(-2, 2)
        scene.ground.heights.uniform_(0, 0.5)
        values = torch.randint(0, 256, scene.occupancy.values.shape)
        scene.occupancy.values.copy_(torch.where(torch.rand(values.shape) < 0.5, 0, values))
        scene.log_beta.fill_(2.0)
    return scene


def traced(scene: SceneModel, there: bool = True) -> SegmentTrace:
    drive = drive_of([still("car", [0, 0, 1.0], np.array([12.0, 3.0, 3.0]))] if there else [])
    tables = scene.actors.tables()
    active = active_actor_tensors(active_actors(whole_state(drive), {"": ("car",)}), {"": (scene, tables)})
    d = np.random.default_rng(0).normal([1, 0, 0], [0, 0.3, 0.1], (RAYS, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    origins = scene.frame.recentred(np.tile([-20.0, 0, 1.6], (RAYS, 1)))
    batch = RayBatch(origins, torch.tensor(d).float(), torch.zeros(RAYS).double())
    return trace(scene, active, batch, Sampling(jitter=True, generator=torch.Generator().manual_seed(2)))


def gradient(scene: SceneModel, of: SegmentTrace) -> Tensor:
    scene.zero_grad()
    (of.feature.sum() + of.depth_m.sum()).backward()
    table = scene.static.grid.table.grad
    assert table is not None
    return table.flatten().clone()


def in_plain_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (places, segments):
        monkeypatch.setattr(module, "are_compiled", lambda scene, like: False)


def test_samples_and_gradients_are_those_of_plain_torch(scene: SceneModel, monkeypatch: pytest.MonkeyPatch) -> None:
    assert places.are_compiled(scene, torch.zeros(1, 3))
    ours = traced(scene)
    of_ours = gradient(scene, ours)
    in_plain_torch(monkeypatch)
    plain = traced(scene)
    of_plain = gradient(scene, plain)
    assert ours.static is not None and plain.static is not None
    assert torch.equal(ours.static[0].ray, plain.static[0].ray) and len(ours.static[0]) > 200
    off = (ours.static[0].t - plain.static[0].t).abs()
    # where the distribution is flat a rounding moves a place by some millimetres
    assert float(off.median()) < 1e-4 and float(off.quantile(0.99)) < 0.01
    assert float((ours.depth_m - plain.depth_m).detach().abs().median()) < 1e-3
    assert float(torch.cosine_similarity(of_ours, of_plain, dim=0)) > 0.999
    assert ours.background is not None and plain.background is not None
    both = np.isin(ours.background.ray, plain.background.ray), np.isin(plain.background.ray, ours.background.ray)
    behind = [
        x.background.t[torch.as_tensor(rows)] for x, rows in zip((ours, plain), both, strict=True) if x.background
    ]
    assert len(behind[0]) > 50
    torch.testing.assert_close(behind[0], behind[1], rtol=1e-3, atol=1e-3)


def test_boxes_are_cleared_by_the_kernel(scene: SceneModel, monkeypatch: pytest.MonkeyPatch) -> None:
    last = scene.static.network[-1]
    assert isinstance(last, torch.nn.Linear)
    with torch.no_grad():
        last.bias[0] = -1.0  # solid everywhere but in the box
        cleared, filled = traced(scene), traced(scene, there=False)
        in_plain_torch(monkeypatch)
        plain = traced(scene)
    assert cleared.static is not None and filled.static is not None and plain.static is not None
    assert float((cleared.static[0].t - plain.static[0].t).abs().quantile(0.99)) < 0.02
    assert float((cleared.static[0].t - filled.static[0].t).abs().max()) > 1.0


def test_a_ray_without_an_occupied_voxel_has_no_sample(scene: SceneModel) -> None:
    scene.occupancy.values.zero_()
    with torch.no_grad():
        assert traced(scene).static is None
