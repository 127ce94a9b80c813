"""An actor follows the light on the ground under it, for cameras; a foreign actor brings its own; mirrored appearances
keep their geometry."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from analytic_scene import drive_of, still
from stress.scenes import image_rays, make_scene
from whole_drive import bound_to

from unisim_blender.core import native
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.model.volume import Volume
from unisim_blender.core.presets import preset
from unisim_blender.core.render.quality import QUALITIES
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.render.tracers.torch.segments import _median, _mirrored
from unisim_blender.core.render.tracers.torch.tracer import TorchBackend
from unisim_blender.core.sensors.frames import RenderStats


def scene() -> SceneModel:
    torch.manual_seed(0)
    model = SceneModel(preset("tiny").model, Volume(np.eye(4), np.full(3, 10.0)), ("a",), ())
    model.static.grid.table.data.normal_()
    return model


def test_light_changes_nothing_before_it_is_learnt() -> None:
    model = scene()
    feature = torch.randn(5, 3, model.config.features)
    assert torch.equal(model.lit(feature, torch.rand(5, 3) * 10), feature)


def test_light_follows_the_ground_and_not_the_height() -> None:
    model = scene()
    assert model.light is not None
    last = model.light.network[-1]
    assert isinstance(last, torch.nn.Linear)
    torch.nn.init.normal_(last.weight)
    feature = torch.randn(1, 3, model.config.features).expand(2, -1, -1)
    place = torch.tensor([[2.0, 2.0, 1.0], [2.0, 2.0, 3.0]])
    low, high = model.lit(feature, place)
    assert torch.allclose(low, high, atol=1e-4)
    here, there = model.lit(feature, torch.tensor([[2.0, 2.0, 1.0], [7.0, 6.0, 1.0]]))
    assert not torch.allclose(here, there, atol=1e-3)


def test_light_is_learnt_by_its_network_alone() -> None:
    model = scene()
    assert model.light is not None
    model.lit(torch.randn(4, 2, model.config.features), torch.rand(4, 3) * 10).square().sum().backward()
    assert model.static.grid.table.grad is None
    assert all(p.grad is not None for p in model.light.parameters())


def test_mirrored_directions_flip_across_the_box_alone() -> None:
    d = torch.nn.functional.normalize(torch.tensor([[1.0, 2, 3], [1, 2, 3]]), dim=-1)
    across = torch.tensor([[0.0, 1, 0], [0, 1, 0]])
    out = _mirrored(d, across, torch.tensor([-1.0, 1.0]))
    assert torch.allclose(out[0], d[0] * torch.tensor([1.0, -1, 1])) and torch.equal(out[1], d[1])


def test_the_light_is_that_of_the_median_sample() -> None:
    """Of a ray segment that stops 1 - e^-2 of its ray, half is stopped at depth ln(2 / (1 + e^-2)) = 0.566."""
    tau = torch.tensor([
        [0.5, 0.5, 0.5, 0.5],
        [0.0, 0.0, 0.0, 9.0],
        [9.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0],
        [0.1, 0.1, 1.8, 0.0],
    ])  # fmt: skip
    assert _median(tau)[:, 0].tolist() == [1, 3, 0, 0, 2]


@pytest.mark.skipif(native.library() is None, reason="the kernels were not built")
@pytest.mark.parametrize("quality", ("reference", "balanced"))
def test_kernels_and_torch_light_an_actor_from_one_place(tmp_path: Path, quality: str) -> None:
    """A long box that stops rays little by little over ground whose appearance changes from metre to metre: wherever
    else the light were taken, features would be others."""
    long = still("car", (-8, 0, 0.8), (12.0, 6.0, 3.0), yaw=0.3)

    def lit_a_lot(model: SceneModel) -> None:
        scene: Any = model
        scene.light.network[-1].weight.normal_(0, 1.0)
        scene.log_beta.fill_(float(np.log(4.0)))
        scene.occupancy.values.zero_()

    folder = make_scene(tmp_path / "scene", drive_of([long]), lit_a_lot)
    drive = drive_of([long])
    rays = image_rays(drive)
    fast = bound_to(CompiledBackend(CompiledScene(folder), QUALITIES[quality]), drive)
    slow = bound_to(TorchBackend(load_scene(folder), QUALITIES["reference"]), drive)
    found, wanted = (t.trace(rays, {"instance"}, True, None, RenderStats()) for t in (fast, slow))
    actor = (found.maps["instance"] == 1) & (wanted.maps["instance"] == 1)
    assert actor.sum() > 100
    scale = np.asarray(wanted.feature)[actor].std()
    wrong = np.abs(np.asarray(found.feature)[actor] - np.asarray(wanted.feature)[actor]).max(1) / scale
    # the march's own samples are others than torch's: what is left of the difference at `balanced` is theirs
    half, most = (1e-4, 1e-2) if quality == "reference" else (0.04, 3.0)
    assert np.quantile(wrong, 0.5) < half and wrong.max() < most
    assert np.quantile(wrong, 0.9) < 4 * half
