"""A step whose shapes no value decides: it has the terms and gradients of the plain one, and never waits for a device."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small_training
import torch
import torch.nn.functional as F
from no_host_decisions import HostDecision, NoHostDecisions
from small_training import small_log
from torch import Tensor

from unisim_blender.core import native
from unisim_blender.core.data.log import Log
from unisim_blender.core.ops import padding, propose
from unisim_blender.core.ops.padding import Padding, drawn, masked_mean, masked_quantile, selected
from unisim_blender.core.ops.ray_segments import RayBatch
from unisim_blender.core.presets import PRESETS
from unisim_blender.core.render.tracers.torch import segments
from unisim_blender.core.training import setup
from unisim_blender.core.training.batches.data import CameraData, LidarData
from unisim_blender.core.training.batches.images import PixelChoice, PixelDraw
from unisim_blender.core.training.batches.on_device import DeviceImages, DeviceSweeps
from unisim_blender.core.training.checkpoint import load_checkpoint, save_checkpoint
from unisim_blender.core.training.on_device import READ_EVERY, DeviceTrainer
from unisim_blender.core.training.trainer import Trainer

EVERYTHING = dataclasses.replace(small_training.EVERYTHING, patches=4, lidar_rays=256)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    return small_log(tmp_path_factory.mktemp("device") / "log")


@pytest.mark.parametrize(
    "decision",
    [
        lambda x: float(x.sum()),
        lambda x: x[x > 0],
        lambda x: torch.nonzero(x),
        lambda x: bool((x > 0).any()),
        lambda x: x.unique(),
        lambda x: x.repeat_interleave(x.long()),
        lambda x: torch.where(x > 0, x, torch.tensor(1.0)),
        lambda x: x.index_put_((x > 0,), x.sum()),
    ],
)
def test_what_waits_is_refused(decision: Callable[[Tensor], Any]) -> None:
    x = torch.tensor([0.0, 1.0, 2.0])
    with NoHostDecisions(), pytest.raises(HostDecision):  # type: ignore[no-untyped-call]
        decision(x)


def test_rows_are_selected_in_tensors_of_a_fixed_length() -> None:
    mask = torch.tensor([False, True, True, False, True])
    for most, wanted in ((5, [1, 2, 4]), (3, [1, 2, 4]), (2, [1, 2])):
        index, there = selected(mask, most)
        assert len(index) == most and index[there].tolist() == wanted and int(index.max()) < 5
    assert not selected(torch.zeros(4, dtype=torch.bool), 3)[1].any()
    index, some = drawn(mask, 3000, torch.Generator().manual_seed(0))
    assert some and torch.bincount(index, minlength=5)[mask].tolist() == pytest.approx([1000] * 3, abs=120)
    assert set(index.tolist()) == {1, 2, 4} and not drawn(~mask & mask, 2, None)[1]
    values = torch.tensor([9.0, 1.0, 2.0, float("nan"), 6.0])
    assert float(masked_mean(values, mask)) == 3 and float(masked_mean(values, mask & ~mask)) == 0
    for share in (0.0, 0.3, 0.95, 1.0):
        assert torch.equal(masked_quantile(values, mask, share), torch.quantile(values[mask], share))


def test_rows_that_found_no_place_are_counted() -> None:
    lengths = Padding(0.5, torch.zeros((), dtype=torch.long))
    assert len(lengths.rows(torch.ones(7, dtype=torch.bool), 8)[0]) == 4 and int(lengths.missed) == 3


def terms_of(trainer: Trainer, lengths: Padding | None) -> tuple[dict[str, Tensor], list[Any], list[Tensor]]:
    """Every term of a step, what was traced, and the gradients of all leaves."""
    branches = trainer.branches
    deferred = trainer.deferred()
    trainer.shape.padded = lengths is not None
    for sink, _ in trainer._sinks_of(deferred["tables"]):
        sink.clear()
    start = dataclasses.replace(trainer._start(0, 0.5, deferred, Future()), padding=lengths)
    batches, draw = branches.draw_pixels(start.rng, 0)
    lidar = trainer.lidar.sample(start.rng, trainer.config.lidar_rays)
    weight = None if draw is None else torch.as_tensor(draw.weight).float()
    leaves = [*start.gradients.leaves, *(trainer.camera_poses.parameters())]

    def step() -> tuple[dict[str, Tensor], list[Any], list[Tensor]]:
        terms, _, _, traced = branches.terms(start, batches, weight, lidar)
        gradients = torch.autograd.grad(torch.stack(list(terms.values())).sum(), leaves, allow_unused=True)
        for number, trace in enumerate(traced):
            branches.update_occupancy(start, trace, camera=number == 0)
        return terms, traced, [torch.zeros(()) if g is None else g for g in gradients]

    if lengths is None:
        return step()
    with NoHostDecisions():  # type: ignore[no-untyped-call]
        return step()


@pytest.fixture
def even(monkeypatch: pytest.MonkeyPatch) -> None:
    """Random numbers that do not depend on how many are drawn, and plain torch."""
    monkeypatch.setattr(native, "library", lambda: None)

    def shape_of(sizes: tuple[Any, ...]) -> tuple[int, ...]:
        return tuple(sizes[0]) if len(sizes) == 1 and not isinstance(sizes[0], int) else sizes

    def picked(mask: Tensor, count: int, generator: object) -> tuple[Tensor, Tensor]:
        ends = mask.cumsum(0)
        place = (torch.linspace(0, 0.999, count) * ends[-1]).long() + 1
        return torch.searchsorted(ends, torch.minimum(place, ends[-1]).clamp_min(1)).clamp_max(len(mask) - 1), ends[
            -1
        ] > 0

    monkeypatch.setattr(torch, "rand", lambda *sizes, **_: torch.full(shape_of(sizes), 0.37))
    monkeypatch.setattr(torch, "randn", lambda *sizes, **_: torch.full(shape_of(sizes), 0.3).cumsum(-1) - 0.5)
    monkeypatch.setattr(torch, "randint", lambda n, size, **_: (torch.linspace(0, 0.999, size[0]) * n).long())
    for module in (padding, __import__("unisim_blender.core.training.losses.shape", fromlist=["drawn"])):
        monkeypatch.setattr(module, "drawn", picked)


@pytest.mark.parametrize("changes", [{}, {"preset": "ngp"}, {"preset": "nsg"}, {"density": "unisim"}], ids=str)
def test_padded_terms_and_gradients_are_the_plain_ones(log: Log, even: None, changes: dict[str, Any]) -> None:
    made = []
    for hits in (None, 2.0):
        trainer = Trainer(log, dataclasses.replace(EVERYTHING, **changes))
        torch.manual_seed(0)
        with torch.no_grad():
            for p in trainer.model.parameters():
                p.add_(0.05 * torch.sin(torch.arange(p.numel()).view(p.shape)))
        lengths = None if hits is None else Padding(hits, torch.zeros((), dtype=torch.long))
        made.append((*terms_of(trainer, lengths), trainer))
        assert lengths is None or not lengths.missed
    (terms, traced, gradients, plain), (padded_terms, padded, padded_gradients, other) = made
    assert terms.keys() == padded_terms.keys() and len(terms) >= 3
    for a, b in zip(traced, padded, strict=True):
        for name in ("feature", "depth_m", "opacity", "volume_depth_m"):
            torch.testing.assert_close(getattr(b, name), getattr(a, name), rtol=2e-4, atol=2e-5)
    for name, value in terms.items():
        torch.testing.assert_close(padded_terms[name], value, rtol=2e-4, atol=1e-6)
    for a, b in zip(gradients, padded_gradients, strict=True):
        torch.testing.assert_close(b, a, rtol=2e-3, atol=1e-7 + 1e-4 * float(a.abs().max()))
    assert sum(bool((a != 0).any()) for a in gradients) > 8, "most parameters learn something"
    for name, state in plain.occupancy.state().items():
        torch.testing.assert_close(other.occupancy.state()[name], state, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("hits", [None, 2.0])
def test_cameras_learn_from_the_static_field(
    log: Log, even: None, monkeypatch: pytest.MonkeyPatch, hits: float | None
) -> None:
    """The corrections' gradients are finite differences at samples that stay where they are along their rays."""
    trainer = Trainer(log, EVERYTHING)
    for module in (trainer.model, trainer.tracklets, trainer.camera_poses):
        module.double()
    monkeypatch.setattr(setup, "zeros_on_demand", lambda shape, **_: torch.zeros(shape, dtype=torch.float64))
    with torch.no_grad():
        for p in trainer.model.parameters():
            p.add_(0.05 * torch.sin(torch.arange(p.numel()).view(p.shape)))
    lengths = None if hits is None else Padding(hits, torch.zeros((), dtype=torch.long))
    start = dataclasses.replace(trainer._start(0, 0.5, trainer.deferred(), Future()), padding=lengths)
    batches = [
        dataclasses.replace(b, rays=RayBatch(b.rays.origins.double(), b.rays.directions.double(), b.rays.time_s))
        for b in trainer.branches.draw_pixels(start.rng, 0)[0]
    ]
    placed, calls = list[Any](), 0

    def replayed(*args: Any) -> Any:
        nonlocal calls
        if calls == len(placed):
            placed.append(propose.propose(*args))
        calls += 1
        return placed[calls - 1]

    monkeypatch.setattr(segments, "propose", replayed)

    def stopped() -> Tensor:
        nonlocal calls
        calls = 0
        static = trainer.branches.seen(start, batches)[1].static
        assert static is not None and len(static[0].ray)
        features = static[0].features
        return (static[0].stop_fraction[..., None] * features * torch.arange(1, features.shape[-1] + 1)).sum()

    parameters = list(trainer.camera_poses.parameters())
    gradients = torch.autograd.grad(stopped(), parameters)
    for parameter, gradient in zip(parameters, gradients, strict=True):
        for at in ((0, 1, 0), (0, 2, 1), (0, 0, 2)):
            ends = []
            for step in (1e-6, -1e-6):
                with torch.no_grad():
                    parameter[at] += step
                    ends.append(float(stopped()))
                    parameter[at] -= step
            assert float(gradient[at]) == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=2e-3)
            assert abs(float(gradient[at])) > 1e-3


def test_a_device_draws_the_cells_rays_and_beams_that_the_host_draws(log: Log) -> None:
    trainer = Trainer(log, EVERYTHING)
    cameras, up = trainer.cameras, trainer.model.config.upsample
    torch.manual_seed(0)
    images = DeviceImages(cameras, trainer.choice, 8, up, "cpu")
    patches = images.patches(40)
    cells, block, weight = images.scattered(500)
    edge = 8 * up
    room = cameras.corners("front_camera", edge)
    drawn_corners = images.corner.tolist()
    assert drawn_corners == room.tolist() and patches.target.shape == (40, 3, edge, edge)
    choice = trainer.choice
    rng = np.random.default_rng(0)
    view, x, y = (
        rng.integers(len(cameras.views), size=60),
        *(rng.integers(n - up, size=60) for n in (images_width(cameras))),
    )
    order = np.argsort(view, kind="stable")
    wanted = cameras.pixels(PixelDraw(view[order], x[order], y[order], np.zeros(60, int), np.ones(60)), up)
    got = images.batch(torch.as_tensor(view[order]), torch.as_tensor(x[order]), torch.as_tensor(y[order]), 1)
    assert torch.equal(got.target, wanted.target) and torch.equal(got.camera, wanted.camera)
    for name in ("origins", "directions", "time_s"):
        torch.testing.assert_close(getattr(got.rays, name), getattr(wanted.rays, name), rtol=0, atol=2e-5)
    torch.testing.assert_close(got.world_from_camera, wanted.world_from_camera, rtol=0, atol=1e-6)
    # chances, weights and errors are the host's
    assert float(weight.mean()) == pytest.approx(1.0, abs=0.2) and int(block.max()) < len(choice.view)
    host = PixelChoice(cameras.rooms(up))
    square = np.linspace(0, 1, len(block))
    host.note(block.numpy(), square)
    images.note(block, torch.as_tensor(square))
    np.testing.assert_allclose(choice.state()["error"], host.state()["error"], rtol=1e-12)
    chances = np.bincount(host.draw(rng, 200_000).block, minlength=len(choice.view)) / 200_000
    mine = np.bincount(images.scattered(200_000)[1], minlength=len(choice.view)) / 200_000
    assert np.abs(chances - mine).sum() < 0.1 + np.sqrt(len(mine) / 200_000)


def images_width(cameras: CameraData) -> tuple[int, int]:
    model = cameras.cameras["front_camera"].model
    return model.width, model.height


def test_a_device_draws_beams_as_the_host_does(log: Log) -> None:
    lidar = Trainer(log, EVERYTHING).lidar
    assert isinstance(lidar, LidarData)
    torch.manual_seed(0)
    mine, host = DeviceSweeps(lidar, "cpu").sample(1000), lidar.sample(np.random.default_rng(0), 1000)
    assert int(mine.returned.sum()) == int(host.returned.sum()) and len(mine.rays) == 1000
    assert sorted(set(mine.weight.tolist())) == pytest.approx(sorted(set(host.weight.tolist())))
    assert len(lidar.of_actors) > 5
    of_actors = set(map(tuple, lidar.directions[lidar.of_actors].tolist()))
    counts = [sum(tuple(d) in of_actors for d in batch.rays.directions.tolist()) for batch in (mine, host)]
    even = 850 * len(of_actors) / lidar.returned.sum()
    assert min(counts) > 2 * even and abs(counts[0] - counts[1]) < 6 * np.sqrt(sum(counts))
    at = {tuple(d): t for d, t in zip(lidar.directions.tolist(), lidar.depth_m.tolist(), strict=True)}
    assert all(at[tuple(d)] == t for d, t in zip(mine.rays.directions.tolist(), mine.depth_m.tolist(), strict=True))


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "library", lambda: None)


@pytest.mark.parametrize("preset", ["tiny", pytest.param("compact", marks=pytest.mark.slow)])
def test_no_step_waits_for_its_device(log: Log, plain: None, preset: str) -> None:
    """Draws, of pixels apart where a decoder looks at each by itself, gradients, optimisers and occupancy, in every phase;
    the loss is read every ten steps."""
    phases: dict[str, Any] = {"unobserved_from": 0.08, "poses_from": 0.05, "still_from": 0.12}
    trainer = DeviceTrainer(log, dataclasses.replace(EVERYTHING, preset=preset, patches=2, patch_cells=12, **phases))
    assert trainer.unsuited() is None
    metrics = [trainer.step() for _ in range(10)]
    assert all(not each for each in metrics[:-1]) and {"loss", "psnr", "lidar_m", "rgb", "eikonal"} <= set(metrics[-1])
    before = [p.detach().clone() for p in trainer.model.parameters()]
    for number in range(1, 10):
        with NoHostDecisions():  # type: ignore[no-untyped-call]
            assert trainer.step() == {}, number
    assert sum(bool((a != b).any()) for a, b in zip(before, trainer.model.parameters(), strict=True)) > 8
    assert {"unobserved", "normal_smoothness"} <= set(trainer.step()) and len(trainer._graphs) > 6


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU: NoHostDecisions stands in for its check")
def test_no_step_synchronises_a_gpu(log: Log) -> None:
    """CUDA itself refuses what waits, before the loss is read, in steps that are captured and replayed."""
    trainer = DeviceTrainer(log, dataclasses.replace(EVERYTHING, device="cuda"))
    for _ in range(20):  # every phase once, and captured
        trainer.step()
    try:
        torch.cuda.set_sync_debug_mode("error")
        for number in range(1, READ_EVERY):
            assert trainer.step() == {}, number
    finally:
        torch.cuda.set_sync_debug_mode("default")
    assert {"loss", "rgb"} <= set(trainer.step())


def test_bfloat16_learns_as_float32_does(log: Log, plain: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """The gradients of a step point the same way, and losses after 40 steps are the same within what a seed changes."""
    gradients, ends = [], []
    for half in (False, True):
        monkeypatch.setitem(PRESETS, "tiny", dataclasses.replace(PRESETS["tiny"], bfloat16=half))
        trainer = DeviceTrainer(log, dataclasses.replace(EVERYTHING, patches=8))
        trainer.step()
        parameters = [p for p in trainer.model.parameters() if p.grad is not None]
        gradients.append([p.grad.flatten().clone() for p in parameters if p.grad is not None])
        ends.append(np.mean([trainer.step().get("rgb", 0.0) for _ in range(39)][-1:]))
    cosines = [float(F.cosine_similarity(a, b, 0)) for a, b in zip(*gradients, strict=True) if bool((a != 0).any())]
    assert len(cosines) > 8 and min(cosines) > 0.97 and sorted(cosines)[len(cosines) // 2] > 0.999
    assert any(not torch.equal(a, b) for a, b in zip(*gradients, strict=True))
    assert ends[1] == pytest.approx(ends[0], rel=0.1)


def test_more_hits_than_there_is_room_for_make_room(log: Log, plain: None) -> None:
    trainer = DeviceTrainer(log, EVERYTHING)
    assert trainer.padding is not None
    trainer.padding.hits_per_ray = 1e-3
    for _ in range(10):
        trainer.step()
    assert trainer.padding.hits_per_ray == pytest.approx(1.5e-3) and not trainer.padding.missed


def test_a_device_learns_as_the_host_does_and_resumes(log: Log, tmp_path: Path) -> None:
    """The same losses after as many steps, within what a seed changes; a checkpoint goes on to the same bits."""
    config = dataclasses.replace(EVERYTHING, patches=8, iterations=60)
    host, device = Trainer(log, config), DeviceTrainer(log, config)
    table = device.model.static.grid.table.detach().clone()
    losses = [[trainer.step().get("rgb") for _ in range(40)] for trainer in (host, device)]
    assert bool((device.model.static.grid.table != table).any()), "what sinks collect is learnt, too"
    save_checkpoint(tmp_path / "kept", device)
    ends = [np.mean([loss for loss in each[20:] if loss is not None]) for each in losses]
    begins = [next(loss for loss in each if loss is not None) for each in losses]
    assert ends[1] == pytest.approx(ends[0], rel=0.25) and ends[1] < 0.8 * begins[0]
    again = DeviceTrainer(log, config)
    load_checkpoint(tmp_path / "kept", again)
    for _ in range(10):
        wanted, got = device.step(), again.step()
    assert wanted == got
    assert all(torch.equal(a, b) for a, b in zip(device.model.parameters(), again.model.parameters(), strict=True))


@pytest.mark.slow
def test_a_steps_forward_pass_is_one_graph_of_operations(log: Log, plain: None) -> None:
    """Torch's compiler, which breaks a graph where Python needs a value, traces it as a whole."""
    trainer = DeviceTrainer(log, EVERYTHING)
    for _ in range(4):
        trainer.step()
    start = trainer._start(0, 0.5, trainer.deferred(), Future())
    batches, blocks, beams = trainer.draw()
    weight = None if blocks is None else blocks[1]

    def loss() -> Tensor:
        return torch.stack(list(trainer.branches.terms(start, batches, weight, beams)[0].values())).sum()

    torch.manual_seed(0)
    wanted = loss()
    torch._dynamo.reset()
    torch.manual_seed(0)
    torch.testing.assert_close(torch.compile(loss, backend="eager", fullgraph=True)(), wanted, rtol=1e-5, atol=1e-6)


def test_what_needs_the_host_says_so(log: Log, capsys: pytest.CaptureFixture[str]) -> None:
    trainer = DeviceTrainer(log, dataclasses.replace(EVERYTHING, adversarial=True))
    assert trainer.padding is None and "psnr" in trainer.step()
    assert "led by the host, which takes longer: the adversarial term has" in capsys.readouterr().err
