"""An actor follows the light on the ground under it, for cameras; a guest brings its own; mirrored looks keep their geometry."""

from __future__ import annotations

import numpy as np
import torch

from unisim_blender.core.fields.config import preset
from unisim_blender.core.fields.scene import SceneModel
from unisim_blender.core.fields.volume import Volume
from unisim_blender.core.trace import _mirrored


def scene() -> SceneModel:
    torch.manual_seed(0)
    model = SceneModel(preset("tiny"), Volume(np.eye(4), np.full(3, 10.0)), ("a",), ())
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
