"""The terms of the training loss, against plain loops and other people's code; the discriminator."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from analytic_scene import Stage, analytic_scene, drive_of, ground, union, wall
from safetensors.torch import save_file
from skimage.metrics import structural_similarity
from torch import Tensor

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.ops.composite import composite
from unisim_blender.core.ops.field_values import SignedDistances
from unisim_blender.core.ops.ray_segments import ActorSegments, RayBatch, RaySegments, StaticSegments
from unisim_blender.core.ops.segment_trace import SegmentTrace
from unisim_blender.core.training.batches.data import PatchBatch
from unisim_blender.core.training.batches.sweeps import LidarBatch
from unisim_blender.core.training.losses.terms import (
    Adversary,
    PatchDiscriminator,
    VggLoss,
    colour_squares,
    distortion,
    eikonal,
    expected_error,
    gradient_difference,
    lidar_terms,
    normal_smoothness,
    perceptual_stand_in,
    sdf_band_loss,
    shifted_patches,
    ssim,
)


def images(n: int = 2, size: int = 40, seed: int = 0) -> Tensor:
    """Smooth random images (n, 3, size, size)."""
    rng = torch.Generator().manual_seed(seed)
    return F.interpolate(torch.rand(n, 3, 8, 8, generator=rng), size=(size, size), mode="bilinear")


def test_what_is_not_grey_counts_more() -> None:
    wrong = images().sub(0.5).double().requires_grad_()
    expected = torch.stack([
        torch.stack([d**2 + 2 * (d - sum(pixel) / 3) ** 2 for d in pixel]) for pixel in wrong.permute(0, 2, 3,
        1).reshape(-1, 3)
    ])  # fmt: skip
    got = colour_squares(wrong, 2.0)
    torch.testing.assert_close(got.permute(0, 2, 3, 1).reshape(-1, 3), expected)
    # the gradient of the sum: twice the difference, and twice as much twice more of what is not grey
    slope = torch.autograd.grad(got.sum(), wrong)[0]
    torch.testing.assert_close(slope, 2 * wrong + 4 * (wrong - wrong.mean(1, keepdim=True)))


def test_grey_counts_as_ever() -> None:
    grey = images()[:, :1].sub(0.5).expand(-1, 3, -1, -1)
    torch.testing.assert_close(colour_squares(grey, 2.0), grey.square())
    red = images()
    torch.testing.assert_close(colour_squares(red, 0.0), red.square(), rtol=0, atol=0)


def test_ssim_is_scikit_images() -> None:
    a = images(1)
    b = (a + 0.1 * torch.randn(a.shape, generator=torch.Generator().manual_seed(1))).clamp(0, 1)
    pair = [x[0].permute(1, 2, 0).double().numpy() for x in (a, b)]
    whole = structural_similarity(  # type: ignore[no-untyped-call]
        *pair, channel_axis=2, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, full=True
    )[1]
    # ours sees whole windows only
    expected = whole[5:-5, 5:-5].mean()
    assert float(ssim(a.double(), b.double())) == pytest.approx(expected, abs=2e-4)
    assert float(ssim(a, a)) == pytest.approx(1, abs=1e-5) and expected < 0.9


def test_the_stand_in_grows_with_blur_and_is_blind_to_nothing() -> None:
    a = images()
    blurred = [F.avg_pool2d(F.pad(a, (k, k, k, k), mode="replicate"), 2 * k + 1, 1) for k in (1, 3, 6)]
    losses = [float(perceptual_stand_in(a, b)) for b in (a, *blurred)]
    assert losses[0] == pytest.approx(0, abs=1e-5) and losses == sorted(losses) and losses[1] > 1e-3
    # a constant offset has no gradients
    assert float(gradient_difference(a, a + 0.1)) == pytest.approx(0, abs=1e-6)


def test_gradient_difference_by_hand() -> None:
    a, b = torch.zeros(1, 1, 4, 4), torch.zeros(1, 1, 4, 4)
    b[..., 2:] = 1.0  # one edge: 4 of 12 horizontal differences, and 2 of 2 at half size
    assert float(gradient_difference(a, b)) == pytest.approx(4 / 12 + 1.0)


@pytest.mark.parametrize(
    ("offset", "s", "loss"),
    (
        (0.0, 0.05, 0.05),
        (0.0, -0.05, 0.05),
        (0.2, 0.2, 0.0),  # as far as the return: head-on
        (0.2, 0.05, 0.0),  # nearer: at a slant
        (0.2, 0.3, 0.1),  # further than the return itself
        (0.2, -0.1, 0.14),  # behind the surface, before the return
        (-0.2, -0.1, 0.0),
        (-0.2, 0.1, 0.14),
        (-0.2, -0.5, 0.3),
    ),
)
def test_distances_about_a_return(offset: float, s: float, loss: float) -> None:
    assert float(sdf_band_loss(torch.tensor([s]), torch.tensor([offset]))) == pytest.approx(loss, abs=1e-6)


def test_turning_is_the_angle_between_normals_however_long() -> None:
    a = torch.tensor([[2.0, 0, 0], [0, 3, 0], [0, 0, 0.5]])
    b = torch.tensor([[0.1, 0, 0], [0, -1, 0], [0, 1.0, 0]])
    assert float(normal_smoothness(a, b).mean()) == pytest.approx((0 + 2 + 2**0.5) / 3)


def test_eikonal() -> None:
    assert float(eikonal(torch.tensor([[0.6, 0.8, 0.0], [0, 0, -1.0]])).mean()) == pytest.approx(0, abs=1e-7)
    assert float(eikonal(torch.tensor([[2.0, 0, 0], [0, 0, 0]])).mean()) == pytest.approx(1.0)


def scene(beta: float = 30.0) -> Stage:
    return Stage(analytic_scene(union(ground, wall(10.0)), {}, beta=beta), drive_of([]))


def rays(n: int = 60) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[type-arg]
    d = np.random.default_rng(0).normal([1, 0, -0.08], [0, 0.2, 0.05], (n, 3))
    return np.array([-20.0, 0, 1.6]), d / np.linalg.norm(d, axis=1, keepdims=True)


def test_spread_is_mip_nerfs_distortion() -> None:
    traced = scene().trace(*rays(), fine=1.0)
    ray_segment, weights = traced.ray_segments[0], traced.weights[0]
    place = ray_segment.stops().log()
    w = weights.intervals
    plain = (w[:, :, None] * w[:, None] * (place[:, :, None] - place[:, None]).abs()).sum((1, 2)).mean()
    assert float(distortion(traced)) == pytest.approx(float(plain), rel=1e-4) and float(plain) > 1e-4


def measured(n: int, factor: float = 1.0, returned: float = 1.0) -> tuple[Stage, LidarBatch]:
    """What a perfect LiDAR measures of the scene, its depths times ``factor``."""
    stage = scene(3000.0)
    o, d = rays(n)
    depth = torch.tensor(np.where(d[:, 2] < 0, -1.6 / d[:, 2], np.inf)).clamp_max(torch.tensor(30 / d[:, 0])).float()
    batch = RayBatch(stage.scene.frame.recentred(np.tile(o, (n, 1))), torch.tensor(d).float(), torch.zeros(n).double())
    hit = torch.arange(n) < returned * n
    return stage, LidarBatch(batch, depth * factor, torch.full((n,), 0.5), hit, torch.ones(n))


def terms_of(stage: Stage, batch: LidarBatch) -> tuple[dict[str, Tensor], Tensor]:
    o, d = rays(len(batch.returned))
    return lidar_terms(stage.trace(o, d, fine=8.0), batch, torch.ones_like(batch.returned))


def test_a_scene_that_fits_its_sweep_has_no_lidar_loss() -> None:
    terms, good = terms_of(*measured(200))
    right = {name: float(value) for name, value in terms.items()}
    wrong = {name: float(value) for name, value in terms_of(*measured(200, 0.9))[0].items()}
    assert right["depth"] < 0.05 and right["opacity"] < 0.05 and right["free"] < 0.15
    assert wrong["depth"] > 10 * right["depth"] and wrong["free"] > 1.5 * right["free"]
    assert int(good.sum()) == 190, "the best 95 %"


def test_the_expected_error_is_least_at_the_median() -> None:
    """A tenth of a ray leaks to 40 m: what stops the rest belongs where the beam returned, not in front of it."""
    t = torch.tensor([[10.0, 40.0]])
    tau = -torch.log1p(-torch.tensor([[0.9, 0.999]]))
    stop_fraction = torch.tensor([[0.0, 0.999]])
    leak = [RaySegments(torch.tensor([0]), t, torch.zeros(1, 2, 1), tau, stop_fraction)]
    found = composite(1, leak, [1], torch.zeros(1, 3))
    traced = SegmentTrace(
        found.feature, found.depth_m, found.opacity, found.transmittance_after, found.depth_m, found.opacity,
        tuple(leak),
        found.weights, 0,
    )  # fmt: skip
    at = {d: float(expected_error(traced, torch.tensor([d]), worst_m=100.0)) for d in (9.0, 10.0, 11.0, 13.0)}
    assert min(at, key=lambda d: at[d]) == 10.0 and float(traced.volume_depth_m) == pytest.approx(13.0, abs=0.1)
    # a ten-thousandth is never stopped
    assert at[10.0] == pytest.approx(0.0999 * 30.0 + 1e-4 * 100.0, abs=1e-3)


def test_drops_have_no_depth() -> None:
    stage, batch = measured(200, returned=0.5)
    batch.depth_m[100:] = 0.0
    terms, good = terms_of(stage, batch)
    assert not bool(good[100:].any()) and float(terms["depth"]) < 0.05


def test_the_worst_rays_are_left_out_but_what_they_passed_is_free() -> None:
    """Eight returns of 200 come from far behind a surface: no depth to learn from, but nothing can stand
    in front of them."""
    right = float(terms_of(*measured(200))[0]["free"])
    stage, batch = measured(200)
    batch.depth_m[:8] += 500.0
    terms, good = terms_of(stage, batch)
    assert not bool(good[:8].any()) and float(terms["depth"]) < 0.05
    assert float(terms["free"]) == pytest.approx(right + 8 / 200, abs=0.01)
    batch.depth_m[:8] = 1.0
    terms, good = terms_of(stage, batch)
    assert not bool(good[:8].any()) and float(terms["free"]) < right + 0.01, (
        "behind a return among the worst anything may be"
    )


def stopped(n: int, boxes: int, early_m: float, depth_m: float) -> tuple[SegmentTrace, LidarBatch]:
    """Beams that come back at a distance; opaque fields stop them: those of boxes too early, the static one at it."""
    some, others = torch.arange(boxes), torch.arange(boxes, n)
    parts: list[RaySegments] = []
    for ray, stop_m, kind in ((some, depth_m - early_m, ActorSegments), (others, depth_m, StaticSegments)):
        t = torch.full((len(ray), 1), stop_m)
        own: dict[str, Any] = {}
        if kind is ActorSegments:
            own = dict(
                actor_set=0, actor=torch.zeros(len(ray), dtype=torch.long), t_near=t[:, 0] - 0.01, t_far=t[:, 0] + 1.0,
                world_from_box=torch.eye(3).expand(len(ray), 3, 3), size_m=torch.ones(len(ray), 3),
            )  # fmt: skip
        parts.append(kind(
            ray=ray, t=t, features=torch.zeros(len(ray), 1, 2), tau=torch.full_like(t, 12.0), stop_fraction=torch.zeros_like(t),
            values=SignedDistances(torch.zeros_like(t)), points=torch.zeros(len(ray), 1, 3), density="logistic",
            beta=torch.tensor(20.0), **own,
        ))  # fmt: skip
    found = composite(n, parts, [2], torch.zeros(n, 2))
    trace = SegmentTrace(
        found.feature, found.depth_m, found.opacity, found.transmittance_after, found.depth_m, found.opacity, tuple(parts),
        found.weights, 0,
    )  # fmt: skip
    rays = RayBatch(torch.zeros(n, 3), torch.ones(n, 3), torch.zeros(n).double())
    return trace, LidarBatch(
        rays, torch.full((n,), depth_m), torch.ones(n), torch.ones(n, dtype=torch.bool), torch.ones(n)
    )


def test_a_walker_of_few_returns_is_not_left_out() -> None:
    """Four beams of 200 stop at the face of a walker's box, half a metre before what returned them, 15 m away: among all they
    are the worst, and within what a beam that grazes the road may be off."""
    trace, batch = stopped(200, 4, 0.5, 15.0)
    terms, good = lidar_terms(trace, batch, torch.ones_like(batch.returned))
    assert bool(good[:4].any()) and float(terms["depth"]) > 0.5 / 200
    assert float(terms["free"]) == pytest.approx(4 / 200, rel=0.01)
    trace, batch = stopped(200, 4, 0.15, 15.0)
    assert float(lidar_terms(trace, batch, torch.ones_like(batch.returned))[0]["free"]) < 1e-4


def vgg_state(tmp_path: Path) -> dict[str, Tensor]:
    torch.manual_seed(0)
    state, channels = {}, 3
    places = {0: 64, 2: 64, 5: 128, 7: 128, 10: 256, 12: 256, 14: 256, 17: 512, 19: 512, 21: 512}
    for place, width in places.items():
        state[f"features.{place}.weight"] = torch.randn(width, channels, 3, 3) * (2 / (9 * channels)) ** 0.5
        state[f"features.{place}.bias"] = torch.randn(width) * 0.01
        channels = width
    return state


def plain_vgg(state: dict[str, Tensor], image: Tensor) -> list[Tensor]:
    """Outputs after ReLU 1_2, 2_2, 3_3 and 4_3, as torchvision numbers the layers."""
    x = (image - torch.tensor([0.485, 0.456, 0.406]).view(1, 3, 1, 1)) / torch.tensor([0.229, 0.224, 0.225]).view(
        1, 3, 1, 1
    )
    out = []
    for place in range(23):
        if place in (4, 9, 16):
            x = F.max_pool2d(x, 2)
        elif f"features.{place}.weight" in state:
            x = F.conv2d(x, state[f"features.{place}.weight"], state[f"features.{place}.bias"], padding=1)
        else:
            x = F.relu(x)
        if place in (3, 8, 15, 22):
            out.append(x)
    return out


@pytest.mark.parametrize("suffix", (".safetensors", ".pth"))
def test_vgg_features(tmp_path: Path, suffix: str) -> None:
    state = vgg_state(tmp_path)
    file = tmp_path / f"vgg{suffix}"
    if suffix == ".pth":
        torch.save({**state, "classifier.0.weight": torch.zeros(2)}, file)
    else:
        save_file(state, file)
    a, b = images(1, 32), images(1, 32, seed=1)
    expected = sum(float((x - y).abs().mean()) for x, y in zip(plain_vgg(state, a), plain_vgg(state, b), strict=True))
    assert float(VggLoss(file)(a, b)) == pytest.approx(expected, rel=1e-4)


def test_vgg_files_that_are_refused(tmp_path: Path) -> None:
    state = vgg_state(tmp_path)
    file = tmp_path / "vgg.safetensors"
    with pytest.raises(UnisimError, match=r"vgg\.safetensors: VGG weights cannot be read"):
        VggLoss(file)
    save_file({**state, "features.5.weight": torch.zeros(1, 2)}, file)
    with pytest.raises(
        UnisimError, match=r"features\.5\.weight of VGG-16 is missing or not of shape \(128, 64, 3, 3\)"
    ):
        VggLoss(file)
    hostile = tmp_path / "vgg.pth"
    torch.save({"features.0.weight": Path(tmp_path)}, hostile)
    with pytest.raises(UnisimError, match=r"vgg\.pth: VGG weights (are refused|cannot be read)"):
        VggLoss(hostile)


def test_a_discriminator_learns_to_tell_and_teaches() -> None:
    adversary = Adversary(rate=2e-3)
    real, fake = images(8, 32), images(8, 32, seed=5)
    fake = F.avg_pool2d(F.pad(fake, (2, 2, 2, 2), mode="replicate"), 5, 1) * 0.6 + 0.2  # washed out
    before = adversary.update(real, fake)
    losses = [adversary.update(real, fake) for _ in range(60)]
    assert losses[-1] < 0.5 * before
    with torch.no_grad():
        scores = [float(adversary.network(x).mean()) for x in (real, fake)]
    assert scores[0] > scores[1] + 0.5
    # following the gradient makes the image look recorded
    image = fake.clone().requires_grad_()
    loss = adversary.generator_loss(image)
    loss.backward()
    assert image.grad is not None and all(p.grad is None or not p.requires_grad for p in adversary.network.parameters())
    with torch.no_grad():
        step = image - 0.02 * image.grad.sign()
    assert float(adversary.generator_loss(step)) < float(loss.detach())


def test_the_generators_loss_leaves_the_discriminator_as_it_is() -> None:
    adversary = Adversary()
    adversary.update(images(2, 32), images(2, 32, seed=1))
    before = {name: value.clone() for name, value in adversary.state().items()}
    adversary.generator_loss(images(2, 32, seed=2).requires_grad_()).backward()
    for name, value in adversary.state().items():
        assert torch.equal(before[name], value), name


def test_a_stored_discriminator_goes_on_as_if_nothing_had_been() -> None:
    pairs = [(images(2, 32, seed=i), images(2, 32, seed=50 + i)) for i in range(6)]
    whole, first, second = Adversary(), Adversary(), Adversary(seed=9)
    for real, fake in pairs:
        whole.update(real, fake)
    for real, fake in pairs[:3]:
        first.update(real, fake)
    second.load_state({name: value.clone() for name, value in first.state().items()})
    for real, fake in pairs[3:]:
        second.update(real, fake)
    for name, value in whole.state().items():
        assert torch.equal(value, second.state()[name]), name


def test_an_adversary_draws_nothing_from_the_common_numbers() -> None:
    torch.manual_seed(4)
    expected = torch.rand(3)
    torch.manual_seed(4)
    Adversary()
    assert torch.equal(torch.rand(3), expected)


@pytest.mark.parametrize("size", (16, 32, 33))
def test_scores_of_patches_of_all_sizes(size: int) -> None:
    scores = PatchDiscriminator()(images(3, size))
    assert scores.shape[:2] == (3, 1) and scores.shape[2] >= 3 and bool(torch.isfinite(scores).all())


def test_shifted_patches_move_sideways_alone() -> None:
    rotation = torch.linalg.qr(torch.randn(40, 3, 3, generator=torch.Generator().manual_seed(0)))[0]
    n = 9
    batch = RayBatch(torch.randn(40 * n, 3), F.normalize(torch.randn(40 * n, 3), dim=-1), torch.rand(40 * n).double())
    numbers = torch.zeros(40, dtype=torch.long)
    patch = PatchBatch(batch, numbers, numbers, torch.zeros(40, 3, 6, 6), rotation, 3)
    moved = shifted_patches(patch, torch.Generator().manual_seed(1))
    trajectory = (moved.rays.origins - batch.origins).view(40, n, 3)
    assert torch.equal(moved.rays.directions, batch.directions) and torch.equal(moved.rays.time_s, batch.time_s)
    torch.testing.assert_close(trajectory, trajectory[:, :1].expand(-1, n, -1), atol=1e-5, rtol=0)
    local = torch.einsum("bji,bj->bi", rotation, trajectory[:, 0])
    torch.testing.assert_close(local[:, 1:], torch.zeros(40, 2), atol=1e-5, rtol=0)
    distance = local[:, 0]
    assert float(distance.abs().max()) <= 2 and float(distance.min()) < -1 and float(distance.max()) > 1
