"""Decoders of composited features to a sensor's measurements."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .config import ModelConfig
from .networks import mlp, run_mlp, spherical_harmonics
from .shapes import Convolution, camera_codes, convolutions, decoder_reach, perceptrons


class RayHead(nn.Module):
    """View-dependent features (N, C) of composited ones (N, F), unit directions (N, 3) and a code of
    the camera (N, 4)."""

    def __init__(self, config: ModelConfig, cameras: int) -> None:
        super().__init__()
        self.codes = nn.Parameter(torch.zeros(camera_codes(cameras)))
        self.network = mlp(*perceptrons(config)["ray_head.network"])

    def forward(self, feature: Tensor, directions: Tensor, camera: Tensor) -> Tensor:
        """``camera`` (N,) numbers the codes; -1 stands for a camera that was not trained and takes their mean."""
        codes = torch.where((camera < 0)[:, None], self.codes.mean(0), self.codes[camera.clamp_min(0)])
        return run_mlp(self.network, torch.cat([feature, spherical_harmonics(directions), codes.to(feature.dtype)], -1))


class ColourHead(nn.Module):
    """Features (N, F) of samples, seen along unit directions (N, 3), to features whose first three are
    a colour in 0..1."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.network = mlp(*perceptrons(config)["colour_head.network"])

    def forward(self, feature: Tensor, directions: Tensor) -> Tensor:
        """Return the features (N, F), the first three of which are a colour in 0..1."""
        colour = torch.sigmoid(self.network(torch.cat([feature, spherical_harmonics(directions)], -1)))
        return torch.cat([colour, feature[:, 3:]], -1)


class SampleColours(nn.Module):
    """Head in place of `RayHead` for samples with colours: their composited colours (N, 3)."""

    def forward(self, feature: Tensor, directions: Tensor, camera: Tensor) -> Tensor:
        return feature[:, :3]


class NoDecoder(nn.Module):
    """Decoder in place of `CameraDecoder` for composited colours (B, 3, H, W), which are the image."""

    reach = 0

    def forward(self, features: Tensor) -> Tensor:
        return features.clamp(0, 1)


def convolution(shape: Convolution) -> nn.Conv2d:
    """Return a convolution that keeps the image's size, edges replicated."""
    return nn.Conv2d(*shape, padding=shape.kernel // 2, padding_mode="replicate")


class Block(nn.Module):
    """x + conv(relu(conv(x))), edges replicated."""

    def __init__(self, first: Convolution, second: Convolution) -> None:
        super().__init__()
        self.first, self.second = convolution(first), convolution(second)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to the same."""
        out: Tensor = x + self.second(F.relu(self.first(F.relu(x))))
        return out


class CameraDecoder(nn.Module):
    """A feature map (B, C, H, W) to an image (B, 3, H * up, W * up) in 0..1: blocks at low resolution, then
    a pixel shuffle."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        *of_blocks, last = convolutions(config).values()
        self.blocks = nn.Sequential(*(Block(*pair) for pair in zip(of_blocks[::2], of_blocks[1::2], strict=True)))
        self.last = convolution(last)
        self.upsample = config.upsample
        self.reach = decoder_reach(config)
        """How many feature cells away an output pixel can depend on."""

    def forward(self, features: Tensor) -> Tensor:
        """Return the image, display-referred sRGB."""
        out = self.last(F.relu(self.blocks(features))) if self.reach else self._apart(features)
        return torch.sigmoid(F.pixel_shuffle(out, self.upsample))

    def _apart(self, features: Tensor) -> Tensor:
        """Decode cells of one pixel each by products of matrices: convolutions of many small images are slow."""

        def product(conv: nn.Module, x: Tensor) -> Tensor:
            assert isinstance(conv, nn.Conv2d)
            return F.linear(x, conv.weight[:, :, 0, 0], conv.bias)

        x = features.permute(0, 2, 3, 1)
        for block in self.blocks:
            assert isinstance(block, Block)
            x = x + product(block.second, F.relu(product(block.first, F.relu(x))))
        return product(self.last, F.relu(x)).permute(0, 3, 1, 2)


class LidarHead(nn.Module):
    """Intensity in 0..1 (N,) and the logit of a return (N,) from composited features, direction, depth and opacity."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.network = mlp(*perceptrons(config)["lidar_head.network"])

    def forward(self, feature: Tensor, directions: Tensor, depth_m: Tensor, opacity: Tensor) -> tuple[Tensor, Tensor]:
        """Return intensity (N,) in 0..1 and the logit (N,) of a return, of feature (N, F), unit directions (N, 3),
        world frame, depth_m (N,), metres, and opacity (N,)."""
        # geometry answers to depth alone: a dark car that returns nothing is no hole
        reach = torch.stack([torch.log1p(depth_m) / 5, opacity], -1).detach()
        out = self.network(torch.cat([feature, spherical_harmonics(directions), reach], -1))
        return torch.sigmoid(out[:, 0]), out[:, 1]
