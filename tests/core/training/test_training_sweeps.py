"""Sweeps that are read as training needs them: which, when, how many, and what they tell of voxels as they come in."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file
from small_log import write_small_log
from small_training import SMALL, stop_after
from tiny_drive import FakeRenderer, TinyLog, tiny_drive

from unisim_blender.core.data.log import SweepGrid
from unisim_blender.core.errors import LogError
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.model.occupancy import FREE, UNKNOWN, Occupancy, OccupancyTrainer
from unisim_blender.core.training.batches import sweeps as module
from unisim_blender.core.training.batches.data import LidarData
from unisim_blender.core.training.batches.sweeps import (
    AHEAD,
    STEPS_PER_SWEEP,
    SweepRef,
    SweepWindow,
    all_sweeps_fit,
    first_sweeps,
)
from unisim_blender.core.training.loop import train
from unisim_blender.core.training.seeding import VoxelEvidence, seed_by_evidence, seed_voxels, voxel_evidence
from unisim_blender.core.training.trainer import Trainer
from unisim_blender.core.world.drive import Drive

FRAMES = 60
CORNER = np.array([-20.0, -10.0, -1.0])
CAPTURES: list[SweepRef] = [("top", frame) for frame in range(FRAMES - 1)]
RAYS = 4 * 36


class LongLog(TinyLog):
    def __init__(self) -> None:
        super().__init__()
        self.drive: Drive = tiny_drive(FRAMES)
        self.renderer = FakeRenderer(self.drive)
        self.read: list[tuple[int, str]] = []

    def sweep_grid(self, lidar: str, frame: int) -> SweepGrid:
        self.read.append((frame, threading.current_thread().name))
        return super().sweep_grid(lidar, frame)


def no_voxels(origins: FloatArray, points: FloatArray) -> VoxelEvidence:
    return VoxelEvidence(*(np.zeros(0, np.int64) for _ in range(3)))


def window_of(log: Any, seed: int = 0, **options: Any) -> SweepWindow:
    return SweepWindow(log, CAPTURES, CORNER, seed, log.drive.actors.values(), no_voxels, **options)


def frames_of(log: Any, time_s: NDArray[np.float64]) -> set[int]:
    stamps = np.array([log.drive.time_s[frame] for frame in range(FRAMES)])
    return set(np.searchsorted(stamps, time_s - 1e-9).tolist())


def test_few_are_read_before_the_first_step_and_begun_by_another_thread() -> None:
    log = LongLog()
    window = window_of(log)
    window.advance(0)
    first = [CAPTURES[number][1] for number in first_sweeps(log.drive, CAPTURES)]
    assert sorted(frame for frame, _ in log.read) == first and len(first) == 12
    here = threading.current_thread().name
    assert all(name == here or name.startswith("sweeps") for _, name in log.read)
    assert [frame for frame, name in log.read if name == here] == first[::-1][
        : sum(name == here for _, name in log.read)
    ]
    assert first[0] == 0 and first[-1] == FRAMES - 2 and np.diff(first).max() <= 6


def test_the_first_are_spread_over_the_way_and_not_over_the_time() -> None:
    drive = tiny_drive(FRAMES)
    track = drive.world_from_ego
    along = np.where(np.arange(FRAMES) < 40, 0.0, 50.0 * (np.arange(FRAMES) - 39))
    stands = replace(drive, world_from_ego=replace(track, positions=np.pad(along[:, None], ((0, 0), (0, 2)))))
    first = first_sweeps(stands, CAPTURES)
    assert len(first) == 16 and len([number for number in first if number < 40]) <= 2, "one for every 60 m"
    still = replace(drive, world_from_ego=replace(track, positions=np.zeros((FRAMES, 3))))
    assert len(first_sweeps(still, CAPTURES)) == 12
    assert first_sweeps(drive, CAPTURES[:3]) == [0, 1, 2]


def test_rays_are_those_of_the_sweeps_of_a_step_and_their_weights_make_up_for_the_draw() -> None:
    log = LongLog()
    window = window_of(log, limit=30 * RAYS * module.RAY_BYTES)
    assert window.nbytes <= 30 * RAYS * module.RAY_BYTES and window.capacity == 30 - AHEAD
    seen: set[int] = set()
    for step in (0, 1, 40, 100, 200):
        window.advance(step)
        batch = window.sample(np.random.default_rng(step), 3000)
        frames = frames_of(log, batch.rays.time_s.numpy())
        assert len(frames) == min(12 + step // STEPS_PER_SWEEP, window.capacity)
        seen |= frames
        assert int(batch.returned.sum()) == 2550 and float(batch.weight.mean()) == pytest.approx(1, abs=1e-6)
        np.testing.assert_array_equal(batch.depth_m.numpy() > 0, batch.returned.numpy())
    assert seen == set(range(FRAMES - 1)), "every sweep has its turn"
    held = LidarData(log, ["top"], log.drive.frames[:1], CORNER)
    window.advance(0)
    wide = window.sample(np.random.default_rng(0), 20000)
    own = frames_of(log, held.time_s)
    assert own == {0}
    first = wide.rays.time_s.numpy() <= held.time_s.max()
    ends = (wide.rays.origins + wide.rays.directions * wide.depth_m[:, None]).numpy()[first & wide.returned.numpy()]
    assert np.abs(np.linalg.norm(ends[:, None] + CORNER - held.points, axis=-1).min(1)).max() < 1e-4


def test_what_may_be_drawn_follows_from_the_step_alone() -> None:
    log, limit = LongLog(), 30 * RAYS * module.RAY_BYTES
    through, jumped, other = window_of(log, limit=limit), window_of(log, limit=limit), window_of(log, 1, limit=limit)
    for step in range(132):
        through.advance(step)
    jumped.advance(131)
    other.advance(131)
    batches = [window.sample(np.random.default_rng(0), 500) for window in (through, jumped, other)]
    for name in ("depth_m", "returned", "weight"):
        assert torch.equal(getattr(batches[0], name), getattr(batches[1], name))
    assert torch.equal(batches[0].rays.time_s, batches[1].rays.time_s)
    assert not torch.equal(batches[0].rays.time_s, batches[2].rays.time_s), "another seed has another order"


def test_every_return_is_told_of_in_the_end() -> None:
    log = LongLog()
    held = LidarData(log, ["top"], log.drive.frames, CORNER)
    parts = np.concatenate(list(window_of(log).points_by_sweep()))
    np.testing.assert_allclose(parts, held.points, atol=1e-4)


def test_a_sweep_that_cannot_be_read_is_the_steps_error() -> None:
    class Broken(LongLog):
        def sweep_grid(self, lidar: str, frame: int) -> SweepGrid:
            if frame == 0:
                raise LogError("00.pkl.gz: cannot be unpacked")
            return super().sweep_grid(lidar, frame)

    with pytest.raises(LogError, match="00.pkl.gz"):
        window_of(Broken()).advance(0)


def test_a_drive_without_sweeps_is_refused_in_a_sentence() -> None:
    config = replace(SMALL, cameras=("front",), lidars=(), frames=(0, 2))
    with pytest.raises(LogError, match=r"tiny: has no LiDAR sweep to train on; the presets ngp and nsg need none"):
        Trainer(TinyLog(), config)


def test_short_drives_are_held() -> None:
    drive = tiny_drive(FRAMES)
    assert all_sweeps_fit(drive, CAPTURES) and all_sweeps_fit(drive, [])
    assert not all_sweeps_fit(drive, CAPTURES * 3)


# What sweeps that come late tell of voxels

SHAPE, VOXEL_M = (40, 30, 12), 0.5


def some_rays(count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    return np.array([3.0, 4.0, 2.0]) + rng.normal(0, 0.3, (count, 3)), rng.uniform(
        [-4, -4, 0.2], [24, 19, 7], (count, 3)
    )


def test_sweeps_seed_voxels_as_their_rays_do() -> None:
    parts = [some_rays(40, seed) for seed in range(3)]
    ground, known = np.full((20, 15), 0.7, np.float32), np.random.default_rng(0).random((20, 15)) < 0.5
    found = seed_by_evidence([voxel_evidence(*part, SHAPE, VOXEL_M) for part in parts], SHAPE, VOXEL_M, ground, known)
    origins, points = (np.concatenate(both) for both in zip(*parts, strict=True))
    np.testing.assert_array_equal(found, seed_voxels(origins, points, SHAPE, VOXEL_M, ground, known))


def seeded(origins: FloatArray, points: FloatArray) -> OccupancyTrainer:
    ground = np.full((20, 15), -5.0, np.float32)
    occupancy = Occupancy(np.array(SHAPE) * VOXEL_M, VOXEL_M)
    values = seed_voxels(origins, points, SHAPE, VOXEL_M, ground, np.zeros((20, 15), bool))
    occupancy.values.copy_(torch.as_tensor(values))
    return OccupancyTrainer(occupancy)


def test_voxels_are_in_the_end_as_if_all_sweeps_had_been_there_from_the_start() -> None:
    parts = [some_rays(40, seed) for seed in range(5)]
    late = seeded(*parts[0])
    before = late.occupancy.values.clone()
    for origins, points in parts[1:]:
        found = voxel_evidence(origins, points, SHAPE, VOXEL_M)
        late.add_evidence(*(torch.as_tensor(cells) for cells in (found.hit, found.beside, found.passed)))
    whole = seeded(*(np.concatenate(both) for both in zip(*parts, strict=True)))
    assert torch.equal(late.occupancy.values, whole.occupancy.values) and not torch.equal(before, late.occupancy.values)
    for name, value in whole.state().items():
        assert torch.equal(late.state()[name], value), name


def test_rays_that_end_nowhere_tell_nothing() -> None:
    found = voxel_evidence(np.zeros((0, 3)), np.zeros((0, 3)), SHAPE, VOXEL_M)
    assert len(found.hit) == len(found.beside) == len(found.passed) == 0
    outside = voxel_evidence(np.full((1, 3), 900.0), np.full((1, 3), 999.0), SHAPE, VOXEL_M)
    assert len(outside.hit) == len(outside.passed) == 0


def test_what_training_has_learnt_of_voxels_without_rays_stays() -> None:
    trainer = seeded(*some_rays(5, 0))
    values = trainer.occupancy.values.view(-1)
    pruned, unknown = (values == UNKNOWN).nonzero()[:2, 0]
    values[pruned] = FREE
    found = voxel_evidence(*some_rays(1, 9), SHAPE, VOXEL_M)
    trainer.add_evidence(*(torch.as_tensor(cells) for cells in (found.hit, found.beside, found.passed)))
    told = set(np.concatenate([found.hit, found.beside, found.passed]).tolist())
    assert int(pruned) not in told and int(values[pruned]) == FREE and not trainer.passed[pruned]
    assert int(unknown) in told or int(values[unknown]) == UNKNOWN


# In training


def test_a_training_of_many_sweeps_resumes_to_the_same_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_small_log(tmp_path / "log")
    log = open_log(tmp_path / "log")
    for name, value in (("MEMORY_SWEEPS", 1), ("FIRST_SWEEPS", (1, 1)), ("STEPS_PER_SWEEP", 2), ("AHEAD", 1)):
        monkeypatch.setattr(module, name, value)
    told: list[int] = []
    evidence = module.SweepWindow.advance

    def spy(window: SweepWindow, step: int) -> list[VoxelEvidence]:
        found = evidence(window, step)
        told.append(len(found))
        return found

    monkeypatch.setattr(SweepWindow, "advance", spy)
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    train(log, SMALL, whole, quiet=True)
    assert told == [0, 0, 1, 0, 1, 0], "a sweep comes in every second step"
    with monkeypatch.context() as patch:
        stop_after(3, 15, patch)
        with pytest.raises(KeyboardInterrupt):
            train(log, SMALL, parts, quiet=True)
    train(log, SMALL, parts, resume=True, quiet=True)
    first, second = (load_file(path / "weights.safetensors") for path in (whole, parts))
    assert all(torch.equal(first[name], second[name]) for name in first)
    assert isinstance(Trainer(log, SMALL).lidar, SweepWindow)
