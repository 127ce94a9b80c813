"""Fields of actors that change their shape: tables of poses, their gradients, their files, and the gaits of a log's people."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from random_scene import CONFIGS, MOVING, TINY, saved
from tiny_drive import TinyLog

from unisim_blender.core.errors import SceneError
from unisim_blender.core.model.actors import GridActors, actor_field
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.model.config import ModelConfig
from unisim_blender.core.model.shapes import GAIT_BINS, gait_rows
from unisim_blender.core.model.tracklets import Tracklets
from unisim_blender.core.ops.encode import GradientSink
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.torch.actor_tensors import ActorSetTensors
from unisim_blender.core.training.gaits import _fitted, gaits_of
from unisim_street.street import build_street

WALKING = CONFIGS["walking"]


def test_tables_of_poses_are_sums_and_so_are_their_gradients() -> None:
    torch.manual_seed(0)
    field = actor_field(dataclasses.replace(TINY, gaits=(("b", 1.2), ("c", 1.5))), ("a", "b", "c")).double()
    assert field.gaits is not None
    tables = field.tables()
    assert len(tables) == 3 + 2 * GAIT_BINS and len(gait_rows(WALKING, ("van",)).owner) == 1 + GAIT_BINS
    angle = 2 * np.pi * (np.arange(GAIT_BINS) + 0.5) / GAIT_BINS
    waves = np.stack([np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)], 1)
    own, further = field.own_rows().detach().numpy(), field.gaits.tables.detach().numpy()
    for walker, row in ((0, 1), (1, 2)):
        for number in range(GAIT_BINS):
            expected = own[row] + sum(waves[number, k] * further[walker, k] for k in range(4))
            got = tables[3 + walker * GAIT_BINS + number].detach().numpy()
            np.testing.assert_allclose(got, expected, atol=1e-8)
    weight = torch.randn_like(tables)
    (tables * weight).sum().backward()
    of_poses = weight[3:].view(2, GAIT_BINS, *tables.shape[1:]).numpy()
    assert field.gaits.tables.grad is not None
    np.testing.assert_allclose(field.gaits.tables.grad.numpy(), np.einsum("qk,gqrf->gkrf", waves, of_poses), atol=1e-5)
    assert {id(p) for p in field.own()} >= {id(field.gaits.tables)}


@pytest.mark.parametrize("sums", ["autograd", "sinks"])
def test_fields_of_poses_without_their_tables_have_the_same_values_and_gradients(sums: str) -> None:
    torch.manual_seed(1)
    field = actor_field(dataclasses.replace(TINY, gaits=(("b", 1.2), ("c", 1.5))), ("a", "b", "c"))
    assert isinstance(field, GridActors) and field.gaits is not None
    for parameter in field.parameters():
        torch.nn.init.normal_(parameter, 0, 0.3)
    row = torch.cat([torch.randint(3, 3 + 2 * GAIT_BINS, (300,)), torch.randint(0, 3, (200,))])[torch.randperm(500)]
    x, weight = torch.rand(500, 3, requires_grad=True), torch.randn(500, 1 + TINY.features)
    for rows in (row, torch.zeros_like(row)):  # the second has rigid actors alone
        field.zero_grad()
        x.grad = None
        values, features = field(field.tables(), x, rows)
        (torch.cat([values.outward()[:, None], features], 1) * weight).sum().backward()
        expected = [
            values.outward(),
            features,
            *(p.grad.clone() for p in (x, *field.parameters()) if p.grad is not None),
        ]
        field.zero_grad()
        x.grad = None
        tables = field.own_rows().detach().requires_grad_()
        if sums == "sinks":
            field.sink, field.gaits.sink = GradientSink(), GradientSink()
        values, features = field(tables, x, rows)
        (torch.cat([values.outward()[:, None], features], 1) * weight).sum().backward()
        further = field.gaits.tables
        for sink, table in ((field.sink, tables), (field.gaits.sink, further)):
            if sink is not None:
                table.grad = torch.zeros_like(table)
                sink.pour(table.grad)
        further.grad = torch.zeros_like(further) if further.grad is None else further.grad
        field.own_rows().backward(tables.grad)
        got = [values.outward(), features, *(p.grad for p in (x, *field.parameters()) if p.grad is not None)]
        for one, other in zip(got, expected, strict=True):
            torch.testing.assert_close(one, other, atol=3e-5, rtol=1e-4)
        field.sink = field.gaits.sink = None
        torch.testing.assert_close(field.values(tables, x, rows).outward(), values.outward(), atol=1e-5, rtol=1e-5)


def test_files_hold_the_tables_once_and_both_readers_make_the_same(tmp_path: Path) -> None:
    folder = saved(tmp_path / "scene", WALKING)
    torch_scene, compiled = load_scene(folder), CompiledScene(folder)
    assert torch_scene.actor_tables.shape[0] == 4 + GAIT_BINS
    table = next(a for a in compiled.arrays if a.dtype == np.float16 and a.shape == torch_scene.actor_tables.shape)
    np.testing.assert_allclose(table.astype(np.float32), torch_scene.actor_tables.numpy(), atol=5e-3, rtol=2e-3)
    moved = torch_scene.actor_tables[4:] - torch_scene.actor_tables[3]
    assert moved.abs().max() > 0.1
    assert compiled.cells.boxes.shape[0] == 4 + GAIT_BINS


def test_scenes_without_gaits_are_written_as_before(tmp_path: Path) -> None:
    assert "gaits" not in TINY.to_dict() and ModelConfig.from_dict(TINY.to_dict()) == TINY
    assert ModelConfig.from_dict(json.loads(json.dumps(WALKING.to_dict()))) == WALKING
    with pytest.raises(SceneError, match="cycle of 'van' that is not from"):
        ModelConfig.from_dict({**WALKING.to_dict(), "gaits": [["van", 0.0]]})
    with pytest.raises(SceneError, match="names 'tram', which is no actor"):
        gait_rows(dataclasses.replace(TINY, gaits=(("tram", 2.0),)), ("van",))


def test_a_pose_follows_the_path_not_the_clock() -> None:
    scene = actor_field(WALKING, ("car", "cone", "near", "van"))
    keys = MOVING.world_from_actor
    slow = dataclasses.replace(MOVING, world_from_actor=dataclasses.replace(keys, times_s=3 * keys.times_s))

    class Model:
        actors = scene

    def rows(actor: object, times: list[float]) -> list[int]:
        one = ActorSetTensors(Model(), torch.zeros(0), Tracklets([actor]), torch.tensor([3]), ("van",))  # type: ignore[arg-type,list-item]
        return one.table_rows(torch.zeros(len(times), dtype=torch.long), torch.tensor(times).double()).tolist()

    times = [0.0, 0.03, 0.11, 0.23, 0.41]
    assert rows(MOVING, times) == rows(slow, [3 * t for t in times])
    bins = [4 + int(float(keys.walked_at(t)) / 1.3 % 1 * GAIT_BINS) for t in times]
    assert rows(MOVING, times) == bins and len(set(bins)) == 5
    large = dataclasses.replace(MOVING, scale=(1.5, 1.0, 1.0))
    assert rows(large, times) == [4 + int(float(keys.walked_at(t)) / 1.95 % 1 * GAIT_BINS) for t in times]
    part = dataclasses.replace(MOVING, world_from_actor=keys.between(0.23, 0.41))
    assert rows(part, times[3:]) == bins[3:]


@pytest.mark.parametrize(("true_m", "guess_m"), [(1.32, 1.48), (1.32, 1.32), (4.7, 4.6)])
def test_a_cycle_is_the_one_at_which_legs_repeat(true_m: float, guess_m: float) -> None:
    rng = np.random.default_rng(1)
    walked = np.linspace(0.0, 5 * true_m, 24) + rng.uniform(-0.02, 0.02, 24)
    angle = 2 * np.pi * walked[:, None] / true_m
    places = 0.2 + 0.1 * np.cos(angle + np.arange(8)) + 0.05 * np.sin(2 * angle) + rng.normal(0, 0.03, (24, 8))
    legs = list(zip(walked.tolist(), places, strict=True))
    assert abs(_fitted(guess_m, legs) / true_m - 1) < 0.03
    assert _fitted(guess_m, legs[:5]) == guess_m  # too few sweeps
    drift = list(zip(walked.tolist(), np.repeat(walked[:, None], 8, 1), strict=True))
    assert _fitted(guess_m, drift) == guess_m  # a trend repeats nowhere


def test_whoever_walks_has_a_gait_and_a_car_has_none() -> None:
    street = build_street(seed=0, frames=12, width=32, height=18, people=3)
    log = TinyLog()
    log.drive = street.drive
    gaits = dict(gaits_of(log, (), street.drive.frames))
    assert set(gaits) == {"cyclist-1", "person-01", "person-02"} and gaits["cyclist-1"] == 4.6
    assert 1.2 < gaits["person-01"] < 1.7
