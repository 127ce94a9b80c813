"""The adversarial term: patches seen from shifted sensor origins are to look like recorded ones (UniSim, section 3.3).

A patch discriminator with spectral normalisation (Isola et al., 2017; Miyato et al., 2018) and the hinge loss
(Lim and Ye, 2017).
"""

from __future__ import annotations

import dataclasses

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.utils.parametrizations import spectral_norm

from ...ops.ray_segments import RayBatch
from ..batches.data import PatchBatch

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
        """The scores."""
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


def shifted(patch: PatchBatch, generator: torch.Generator, reach_m: float = SHIFT_M) -> PatchBatch:
    """The same patches seen from origins moved sideways, each patch by its own random distance up to ``reach_m``."""
    patches = len(patch.camera)
    device = patch.rays.origins.device
    distance = (torch.rand(patches, generator=generator, device=device) * 2 - 1) * reach_m
    shift = distance[:, None] * patch.world_from_camera[:, :, 0].to(patch.rays.origins)
    origins = patch.rays.origins + shift.repeat_interleave(len(patch.rays) // patches, 0)
    return dataclasses.replace(patch, rays=RayBatch(origins, patch.rays.directions, patch.rays.time_s))
