"""The scene model: its fields, the voxels in which they can be non-empty, the decoders, and the light on actors.

Actors are lit like the ground under them: a car turns dark in the shade, also where an edit puts it. A small network
maps the static field's features of the ground around the place where a ray hits an actor to a scale and a shift of the
actor's features. Its input has no coordinates, so it learns the relation of the ground's appearance to the light, and
not the places of shade.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..geometry import FloatArray
from ..ops.constants import GROUND_CELL_M, GROUND_CLEARANCE_M, GROUND_LIGHT_RADIUS_M
from ..ops.devices import zeros_on_demand
from .actors import actor_field
from .config import ModelConfig
from .decode import CameraDecoder, ColourHead, LidarHead, NoDecoder, RayHead, SampleColours
from .fields import BackgroundModel, StaticField, VolumeFrame
from .networks import mlp, run_mlp, spherical_harmonics
from .occupancy import Occupancy
from .shapes import cells_of, perceptrons
from .volume import Volume


class Light(nn.Module):
    """Features of the ground (N, F) to scales and shifts of an actor's features.

    ``home`` (actors, 3), volume coordinates, is where each actor was recorded. Features of two scenes do not compare,
    so a foreign actor keeps the light of that place.
    """

    def __init__(self, config: ModelConfig, actors: int) -> None:
        super().__init__()
        self.network = mlp(*perceptrons(config)["light.network"])
        last = self.network[-1]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.register_buffer("home", torch.zeros(actors, 3))
        self.register_buffer(
            "around", GROUND_LIGHT_RADIUS_M * torch.tensor([[1.0, 0], [-1, 0], [0, 1], [0, -1]]), persistent=False
        )

    home: Tensor
    around: Tensor

    def forward(self, feature: Tensor, appearance: Tensor) -> Tensor:
        """Return features (P, K, F) of actors, relit by features (P, F) of the ground under them."""
        scale, shift = run_mlp(self.network, appearance)[:, None].chunk(2, -1)
        lit: Tensor = feature * (1 + scale) + shift
        return lit


class SceneModel(nn.Module):
    """All networks and tables of a scene. ``actors`` and ``cameras`` are the ids by which actor appearances and camera
    codes are numbered. With one field for everything (``actors="none"``), no actor has an appearance of its own."""

    def __init__(self, config: ModelConfig, volume: Volume, actors: tuple[str, ...], cameras: tuple[str, ...]) -> None:
        super().__init__()
        self.config, self.volume = config, volume
        self.actor_ids = {uid: i for i, uid in enumerate(() if config.actors == "none" else actors)}
        self.camera_ids = {uid: i for i, uid in enumerate(cameras)}
        self.frame = VolumeFrame(volume)
        self.static = StaticField(config, volume)
        self.background = BackgroundModel(config, volume)
        self.actors = actor_field(config, tuple(self.actor_ids))
        self.occupancy = Occupancy(volume.size_m, config.voxel_m)
        self.ground = Ground(volume.size_m)
        self.register_buffer("observed", zeros_on_demand(self.occupancy.values.shape, torch.uint8))
        self.log_beta = nn.Parameter(torch.tensor(math.log(config.beta)))
        self.light = Light(config, len(self.actor_ids)) if config.light == "ground" else None
        if config.colour == "sample":
            self.colour_head = ColourHead(config)
        elif config.head == "sample":
            self.sample_head = mlp(*perceptrons(config)["sample_head"])
        decoded = config.colour == "decoded"
        self.ray_head: RayHead | SampleColours = RayHead(config, len(cameras)) if decoded else SampleColours()
        self.camera_decoder: CameraDecoder | NoDecoder = CameraDecoder(config) if decoded else NoDecoder()
        self.lidar_head = LidarHead(config)

    observed: Tensor

    def directed(self, feature: Tensor, directions: Tensor) -> Tensor:
        """Return features (N, F) with their view direction (N, 3) applied, where the configuration applies it at every
        sample; colours come first where samples have them."""
        if self.config.colour == "sample":
            coloured: Tensor = self.colour_head(feature, directions)
            return coloured
        if self.config.head == "ray":
            return feature
        out: Tensor = self.sample_head(torch.cat([feature, spherical_harmonics(directions)], -1))
        return out

    def lit(self, feature: Tensor, place: Tensor) -> Tensor:
        """Return features (P, K, F) of actors, relit by the ground around places (P, 3), volume coordinates."""
        if self.light is None:
            return feature
        around = (place[:, None] + F.pad(self.light.around, (0, 1))).reshape(-1, 3)
        with torch.no_grad():
            appearance = self.static(self.ground.under(around))[1].view(len(place), len(self.light.around), -1).mean(1)
        lit: Tensor = self.light(feature, appearance)
        return lit

    def beta(self) -> Tensor:
        """Return the density's sharpness, 1 / metres: one for all fields, for an actor's own would outrun its few
        samples."""
        return self.log_beta.exp().clamp_max(1e4)


class Ground(nn.Module):
    """The height grid as a tensor."""

    def __init__(self, size_m: FloatArray) -> None:
        super().__init__()
        self.register_buffer("heights", torch.zeros(cells_of(size_m[:2], GROUND_CELL_M)))

    heights: Tensor

    def height(self, x: Tensor) -> Tensor:
        """Return ground heights (N,), metres, under points (N, 3), volume coordinates; bilinear between cell
        centres."""
        rows, columns = self.heights.shape
        place = torch.stack([x[:, 1] / (columns * GROUND_CELL_M), x[:, 0] / (rows * GROUND_CELL_M)], -1) * 2 - 1
        grid = self.heights.to(x.dtype)[None, None]
        return F.grid_sample(grid, place[None, None], padding_mode="border", align_corners=False)[0, 0, 0]

    def under(self, x: Tensor) -> Tensor:
        """Return the points (N, 3) of the ground that lie over or under points (N, 3), volume coordinates."""
        return torch.cat([x[:, :2], self.height(x)[:, None]], -1)

    def above(self, x: Tensor) -> Tensor:
        """Return which points (N, 3), volume coordinates, are above the ground: (N,) bool."""
        return x[:, 2] > self.height(x) + GROUND_CLEARANCE_M
