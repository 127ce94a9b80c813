"""Terms of the training loss: photometric, perceptual with VGG-16 features from a weights file that the user gives, LiDAR,
and adversarial: patches seen from shifted sensor origins are to look like recorded ones (UniSim, section 3.3)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.utils.parametrizations import spectral_norm

from ...errors import UnisimError
from ...model.networks import read_tensors
from ...ops.padding import masked_mean, masked_quantile
from ...ops.ray_segments import ActorSegments, RayBatch
from ...ops.segment_trace import SegmentTrace
from ..batches.data import PatchBatch
from ..batches.sweeps import LidarBatch

_LAYERS = (64, 64, 0, 128, 128, 0, 256, 256, 256, 0, 512, 512, 512)
"""Channels of VGG-16's convolutions up to relu4_3; 0 is a max-pool (Simonyan and Zisserman, 2015, table 1, D)."""
_TAPS = (2, 4, 7, 10)
"""Numbers of the convolutions whose outputs are compared: relu1_2, 2_2, 3_3, 4_3."""


class VggLoss(nn.Module):
    """Mean absolute difference of VGG-16 features of two images (B, 3, H, W) in 0..1.

    The file is torchvision's ``vgg16`` state (names ``features.N.weight``), as .safetensors or as .pth read without
    unpickling anything but tensors.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        state = read_tensors(path, "VGG")
        self.convolutions = nn.ModuleList()
        self.pool_before: list[bool] = []
        position, channels, pooled = 0, 3, False
        for width in _LAYERS:
            if width == 0:
                pooled, position = True, position + 1
                continue
            layer = nn.Conv2d(channels, width, 3, padding=1)
            for kind in ("weight", "bias"):
                name = f"features.{position}.{kind}"
                value = state.get(name)
                expected = getattr(layer, kind).shape
                if value is None or value.shape != expected:
                    raise UnisimError(f"{path}: {name} of VGG-16 is missing or not of shape {tuple(expected)}")
                getattr(layer, kind).data.copy_(value)
            self.convolutions.append(layer)
            self.pool_before.append(pooled)
            channels, pooled, position = width, False, position + 2
        self.requires_grad_(False)
        self.register_buffer("mean", torch.tensor([0.485, 0.456, 0.406]).view(1, 3, 1, 1))
        self.register_buffer("std", torch.tensor([0.229, 0.224, 0.225]).view(1, 3, 1, 1))

    mean: Tensor
    std: Tensor

    def features(self, image: Tensor) -> list[Tensor]:
        """Outputs of the compared layers."""
        x, out = (image - self.mean) / self.std, []
        for number, (layer, pool) in enumerate(zip(self.convolutions, self.pool_before, strict=True), start=1):
            x = F.relu(layer(F.max_pool2d(x, 2) if pool else x))
            if number in _TAPS:
                out.append(x)
        return out

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        pairs = zip(self.features(a), self.features(b), strict=True)
        return torch.stack([(x - y).abs().mean() for x, y in pairs]).sum()


SURFACE_M, SURFACE_SHARE = 0.2, 0.04
"""Further than this, and this share of its length, from a return a ray hits nothing (epsilon of UniSim, eq. 8). The
share is for rays that graze the road: the same sharpness is blurred there by the sine of the angle. No road is in actors'
boxes, and a walker is half a metre thick."""


SSIM_WINDOW, SSIM_SIGMA = 11, 1.5


def gaussian_mean(x: Tensor, padding: int = 0) -> Tensor:
    """Return means (B, C, h, w) around pixels (B, C, H, W), Gaussian window of 11 with sigma 1.5; ``padding`` zeros around."""
    at = torch.arange(SSIM_WINDOW, dtype=x.dtype, device=x.device) - SSIM_WINDOW // 2
    g = torch.exp(-at * at / (2 * SSIM_SIGMA * SSIM_SIGMA))
    g = g / g.sum()
    window = (g[:, None] * g[None]).expand(x.shape[1], 1, SSIM_WINDOW, SSIM_WINDOW)
    return F.conv2d(x, window, padding=padding, groups=x.shape[1])


def similarity(a: Tensor, b: Tensor, mean: Callable[[Tensor], Tensor] = gaussian_mean) -> Tensor:
    """Return the structural similarity (B, 3, h, w) of images (B, 3, H, W) in 0..1 around each pixel, by local means of values
    that ``mean`` returns (Wang et al., 2004)."""
    ma, mb = mean(a), mean(b)
    va, vb, cov = mean(a * a) - ma * ma, mean(b * b) - mb * mb, mean(a * b) - ma * mb
    c1, c2 = 0.01**2, 0.03**2
    return ((2 * ma * mb + c1) * (2 * cov + c2)) / ((ma * ma + mb * mb + c1) * (va + vb + c2))


def ssim(a: Tensor, b: Tensor) -> Tensor:
    """Mean structural similarity of images (B, 3, H, W) in 0..1, Gaussian window of 11 with sigma 1.5
    (Wang et al., 2004)."""
    return similarity(a, b).mean()


def gradient_difference(a: Tensor, b: Tensor) -> Tensor:
    """Mean absolute difference of horizontal and vertical gradients, at full and half size."""
    total = a.new_zeros(())
    for _ in range(2):
        total = total + (a.diff(dim=-1) - b.diff(dim=-1)).abs().mean() + (a.diff(dim=-2) - b.diff(dim=-2)).abs().mean()
        a, b = F.avg_pool2d(a, 2), F.avg_pool2d(b, 2)
    return total


def perceptual_stand_in(a: Tensor, b: Tensor) -> Tensor:
    """Return the perceptual loss used in place of VGG features where the user gave none: 1 - SSIM plus the difference
    of gradients."""
    return 1 - ssim(a, b) + gradient_difference(a, b)


def colour_squares(wrong: Tensor, chroma: float) -> Tensor:
    """Squares (B, 3, H, W) of differences ``wrong`` of colours, plus ``chroma`` times those of the part
    that is not grey.

    A street is grey nearly everywhere: what tells a red car from a grey one is small in a plain square,
    and learnt late.
    """
    return wrong.square() + chroma * (wrong - wrong.mean(1, keepdim=True)).square()


SATURATED = 0.99
"""From this colour on a recorded pixel may have been brighter."""


def exposed(image: Tensor, log_gain: Tensor, recorded: Tensor) -> Tensor:
    """Return images (B, 3, H, W) times gains, of logarithms (B, 3); where the ``recorded`` (B, 3, H, W) one is saturated, it is
    reached by what is brighter."""
    out = image * log_gain.exp()[:, :, None, None]
    return torch.where(recorded >= SATURATED, out.clamp_max(1), out)


def as_shown(image: Tensor, shown: Tensor | None) -> Tensor:
    """Return images (B, 3, H, W), black where a lens shows nothing (``shown`` (B, 1, H, W) is 0; None: it shows all): whatever
    looks at windows of pixels, across that border, too, then compares what is shown alone."""
    return image if shown is None else image * shown


KEEP = 0.95
"""Share of the rays that returned whose depth counts: the largest errors are left out."""


def lidar_terms(traced: SegmentTrace, batch: LidarBatch, inside: Tensor) -> tuple[dict[str, Tensor], Tensor]:
    """Depth and free-space terms of LiDAR rays, and which rays (N,) are among the best `KEEP` of those that returned.

    The depth term is the expected error of a ray that stops at random, not the error of the expected depth: with that,
    a surface moves towards the sensor to make up for what leaks through it. It leaves out the rays with the largest
    errors (glass, leaves, boxes that do not fit), as in UniSim, of those in actors' boxes and of the others. ``inside``
    (N,) says which returns lie in the volume: there the background model must not stand in for what stopped the ray.
    """
    near = batch.returned & inside
    miss = expected_error(traced, batch.depth_m)
    in_boxes = torch.zeros_like(miss)
    for segments in traced.ray_segments:
        if isinstance(segments, ActorSegments):
            contained = segments.contain(batch.depth_m[segments.ray])
            in_boxes = in_boxes.index_add(0, segments.ray, contained.to(miss.dtype))
    with torch.no_grad():
        good = torch.zeros_like(near)
        # a walker has a thousandth of the returns: among all of them, those of a wrong one would be the worst for ever
        for part in (near & (in_boxes > 0), near & (in_boxes == 0)):
            good = good | part & (miss <= masked_quantile(miss, part, KEEP))
    far = batch.returned & ~inside
    logs = traced.depth_m.clamp_min(1).log(), batch.depth_m.clamp_min(1e-6).log()
    reach = masked_mean(F.smooth_l1_loss(*logs, beta=0.05, reduction="none"), far)
    # whatever returned a beam is there, also where the depth is among the worst
    stopped = torch.where(near, traced.volume_opacity, traced.opacity).clamp_min(1e-4)
    opacity = -torch.where(batch.returned, torch.log(stopped), 0.0).sum() / near.sum().clamp_min(1)
    free, surface_m = traced.feature.new_zeros(()), SURFACE_M + SURFACE_SHARE * batch.depth_m
    for segments, weights in traced.weighted():
        gap, surface = segments.stops() - batch.depth_m[segments.ray, None], surface_m[segments.ray, None]
        if isinstance(segments, ActorSegments):
            surface = surface.clamp_max(SURFACE_M)
        # a beam that came back was free up to where it did, also among the worst: a false surface that stops a whole
        # wall's rays makes them the worst, and would stay for ever
        wrong = (gap < -surface) & batch.returned[segments.ray, None] | (gap > surface) & good[segments.ray, None]
        # the weight itself, not its square: a thousandth far behind moves a mean depth by metres
        free = free + (weights.intervals * wrong).sum()
    return {
        "depth": masked_mean(miss, good),
        "reach": reach,
        "opacity": opacity,
        "free": free / batch.returned.sum().clamp_min(1),
    }, good


def expected_error(traced: SegmentTrace, depth_m: Tensor, worst_m: float = 10.0) -> Tensor:
    """Mean distance in metres (N,) between where rays stop inside the volume and depths (N,), at most ``worst_m`` each,
    which also counts for what is not stopped. It is least where half of what stops a ray has done so at the depth."""
    error = (1 - traced.volume_opacity) * worst_m
    for segments, weights in traced.weighted():
        gap = (segments.stops() - depth_m[segments.ray, None]).abs().clamp_max(worst_m)
        error = error.index_add(0, segments.ray, (weights.intervals * gap).sum(1))
    return error


def sdf_band_loss(s: Tensor, offset_m: Tensor) -> Tensor:
    """Return the losses (N,) of signed distances s (N,) at points ``offset_m`` (N,) before (+) or behind (-) a LiDAR
    return along its ray.

    At the return the distance is 0; before it, it is positive and at most the offset; behind, negative and at least it.
    """
    too_far = F.relu(torch.sign(offset_m) * s - offset_m.abs())
    return torch.where(offset_m == 0, s.abs(), wrong_side(s, offset_m) + too_far)


def wrong_side(s: Tensor, offset_m: Tensor) -> Tensor:
    """Return by how much signed distances s (N,) fall short of a fifth of ``offset_m`` (N,), each as in
    `sdf_band_loss`: (N,)."""
    return F.relu(0.2 * offset_m.abs() - torch.sign(offset_m) * s)


def eikonal(differences: Tensor) -> Tensor:
    """(|gradient| - 1)^2 (N,) of gradients (N, 3)."""
    return (differences.norm(dim=-1) - 1) ** 2


def normal_smoothness(a: Tensor, b: Tensor) -> Tensor:
    """How much directions turn from gradients a (N, 3) to b (N, 3): lengths (N,) of the differences of
    their unit vectors.

    The length, not its square: edges turn a lot, and are meant to.
    """
    return (F.normalize(a, dim=-1) - F.normalize(b, dim=-1)).norm(dim=-1)


def distortion(traced: SegmentTrace) -> Tensor:
    """How far a ray's weight is spread in log depth: the distortion of mip-NeRF 360 (eq. 15), on the
    static segments."""
    if traced.static is None:
        return traced.feature.new_zeros(())
    segments, weights = traced.static
    w = weights.intervals
    place = torch.log(segments.stops().detach().clamp_min(0.1))
    total, first = w.cumsum(-1) - w, (w * place).cumsum(-1) - w * place
    spread = 2 * (w * (place * total - first)).sum(-1)
    return spread.mean() if segments.there is None else masked_mean(spread, segments.there)


SHIFT_M = 2.0
"""Origins are moved by up to this much to either side of the camera."""
OPTIMISER = "optimiser."


class PatchDiscriminator(nn.Module):
    """A score for every part of an image: (B, 3, H, W) in 0..1 to (B, 1, about H / 4, about W / 4), higher
    for recorded ones."""

    def __init__(self, channels: int = 32) -> None:
        super().__init__()
        widths = (3, channels, 2 * channels, 4 * channels)
        layers: list[nn.Module] = []
        for number, (before, after) in enumerate(zip(widths, widths[1:], strict=False)):
            stride = 2 if number < 2 else 1
            layers += [spectral_norm(nn.Conv2d(before, after, 2 + stride, stride, padding=1)), nn.LeakyReLU(0.2)]
        layers.append(spectral_norm(nn.Conv2d(widths[-1], 1, 3, padding=1)))
        self.layers = nn.Sequential(*layers)

    def forward(self, image: Tensor) -> Tensor:
        out: Tensor = self.layers(image * 2 - 1)
        return out


class Adversary:
    """A discriminator with its own optimiser. `generator_loss` teaches the scene, `update` the discriminator."""

    def __init__(self, device: str = "cpu", seed: int = 0, rate: float = 2e-4) -> None:
        with torch.random.fork_rng(devices=[]):  # what else is drawn stays as it is without an adversary
            torch.manual_seed(seed)
            self.network = PatchDiscriminator().to(device)
        # no momentum: two players that follow each other's past circle (Gidel et al., 2019)
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=rate, betas=(0.0, 0.99))

    def generator_loss(self, image: Tensor) -> Tensor:
        """How little the image (B, 3, H, W) looks recorded; its gradient goes to the image alone."""
        self.network.eval().requires_grad_(False)  # eval: spectral norms take their step in `update` only
        return -self.network(image).mean()

    def update(self, real: Tensor, fake: Tensor) -> float:
        """One step of the discriminator on recorded and rendered images (B, 3, H, W), (B', 3, H, W); its loss."""
        self.network.train().requires_grad_(True)
        self.optimiser.zero_grad(set_to_none=True)
        loss = F.relu(1 - self.network(real.detach())).mean() + F.relu(1 + self.network(fake.detach())).mean()
        loss.backward()
        self.optimiser.step()
        return float(loss.detach())

    def state(self) -> dict[str, Tensor]:
        """Return the tensors that a checkpoint stores: the network's and the optimiser's."""
        tensors = dict(self.network.state_dict())
        for number, values in self.optimiser.state_dict()["state"].items():
            tensors |= {f"{OPTIMISER}{number}.{name}": value for name, value in values.items()}
        return tensors

    def load_state(self, state: dict[str, Tensor]) -> None:
        """The inverse of `state`. Raises RuntimeError where the tensors do not fit."""
        self.network.load_state_dict({name: value for name, value in state.items() if not name.startswith(OPTIMISER)})
        steps: dict[int, dict[str, Tensor]] = {}
        for name, value in state.items():
            if name.startswith(OPTIMISER):
                number, key = name[len(OPTIMISER) :].split(".", 1)
                steps.setdefault(int(number), {})[key] = value
        groups = self.optimiser.state_dict()["param_groups"]
        self.optimiser.load_state_dict({"state": steps, "param_groups": groups})


def shifted_patches(patch: PatchBatch, generator: torch.Generator | None, reach_m: float = SHIFT_M) -> PatchBatch:
    """The same patches seen from origins moved sideways, each patch by its own random distance up to ``reach_m``."""
    patches = len(patch.camera)
    device = patch.rays.origins.device
    distance = (torch.rand(patches, generator=generator, device=device) * 2 - 1) * reach_m
    shift = distance[:, None] * patch.world_from_camera[:, :, 0].to(patch.rays.origins)
    origins = patch.rays.origins + shift.repeat_interleave(len(patch.rays) // patches, 0)
    return dataclasses.replace(patch, rays=RayBatch(origins, patch.rays.directions, patch.rays.time_s))
