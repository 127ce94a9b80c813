"""Shapes of a scene model, from its configuration: stated here alone. A configuration's values are checked first.

Torch builds its modules with them, the compiled scene reads its arrays by them, and a file's arrays are checked against
them.
"""

from __future__ import annotations

import ctypes
import dataclasses
import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError, short
from ..geometry import FloatArray
from ..native import SceneStruct
from ..ops.constants import DECAY_PER_M, GROUND_CELL_M, GROUND_CLEARANCE_M
from ..ops.grid_shape import GridShape
from .config import ModelConfig
from .volume import Volume

TensorShape = tuple[int, ...]

SH_WIDTH = 16
"""Number of spherical harmonics of a direction, degrees 0 to 3."""
CAMERA_CODE_SIZE = 4
"""Length of a camera's code."""
LIGHT_HIDDEN = 16
LIDAR_INPUTS = 2
"""Number of inputs of the LiDAR head besides feature and direction: depth and opacity."""
LIDAR_OUTPUTS = 2
"""Number of outputs of the LiDAR head: intensity and the logit of a return."""
GAIT_BINS, GAIT_HARMONICS = 32, 2
"""Number of tables that an actor with a gait has over a cycle, as native/one_ray.h has it, and of the harmonics by which
they differ."""
LATENT_OCTAVES, LATENT_LAYERS = 6, 4
"""Number of octaves of a point's encoding, and of layers, of the network that latents condition."""


class Perceptron(NamedTuple):
    """Widths and depth of a perceptron: the arguments of `networks.mlp`. Only its last layer has a bias."""

    inputs: int
    hidden: int
    outputs: int
    layers: int = 2

    def arrays(self, name: str) -> dict[str, TensorShape]:
        """Its arrays by name; the layers have every second number, as in torch's `Sequential` with
        activations between."""
        widths = [self.inputs, *[self.hidden] * (self.layers - 1), self.outputs]
        shapes: dict[str, TensorShape] = {
            f"{name}.{2 * i}.weight": (out, into) for i, (into, out) in enumerate(pairwise(widths))
        }
        return shapes | {f"{name}.{2 * self.layers - 2}.bias": (self.outputs,)}


class Convolution(NamedTuple):
    """Channels and kernel of a convolution with a bias."""

    inputs: int
    outputs: int
    kernel: int

    def arrays(self, name: str) -> dict[str, TensorShape]:
        return {
            f"{name}.weight": (self.outputs, self.inputs, self.kernel, self.kernel),
            f"{name}.bias": (self.outputs,),
        }


def static_grid(config: ModelConfig, size_m: FloatArray) -> GridShape:
    """Return the hash grid of the static field, in a volume of edges ``size_m`` (3,)."""
    g = config.static_grid
    extent = (float(size_m[0]), float(size_m[1]), float(size_m[2]))
    return GridShape.cubic(extent, g.coarsest, g.finest, g.levels, g.features, g.log2_table)


def background_grid(config: ModelConfig) -> GridShape:
    """Return the hash grid of the background model."""
    g = config.background_grid
    return GridShape.unit(int(g.coarsest), int(g.finest), g.levels, g.features, g.log2_table)


def actor_grid(config: ModelConfig) -> GridShape:
    """Return the hash grid that each actor has a table of."""
    g = config.actor_grid
    return GridShape.unit(int(g.coarsest), int(g.finest), g.levels, g.features, g.log2_table)


def actor_row(config: ModelConfig) -> TensorShape:
    """Return the shape of an actor's own parameters: the table of its grid, or a latent."""
    if config.actors == "latent":
        return (config.latent,)
    grid = actor_grid(config)
    return grid.rows, grid.features


def gait_basis() -> FloatArray:
    """Return the factors (GAIT_BINS, 2 GAIT_HARMONICS) of an actor's further tables at the middle of each bin of a cycle: the
    table of a pose is a sum of tables, as in Gao et al., "Reconstructing Personalized Semantic Facial NeRF Models", 2022."""
    angle = 2 * np.pi * (np.arange(GAIT_BINS) + 0.5) / GAIT_BINS
    waves = [wave(order * angle) for order in range(1, GAIT_HARMONICS + 1) for wave in (np.cos, np.sin)]
    return np.stack(waves, 1)


class GaitRows(NamedTuple):
    """Rows of actors' tables once those of poses are made: ``first`` (A,) of each appearance, ``cycles_m`` (A,), 0 for a rigid
    one, which has one row; ``owner`` (R,), the appearance of each row. Those of poses follow the A own ones."""

    first: NDArray[np.int32]
    cycles_m: FloatArray
    owner: NDArray[np.int64]


def gait_rows(config: ModelConfig, appearances: Sequence[str]) -> GaitRows:
    """Return the rows of the tables of appearances. Raises `SceneError` where an actor with a gait is none of them."""
    number = {uid: i for i, uid in enumerate(appearances)}
    if unknown := [uid for uid, _ in config.gaits if uid not in number]:
        raise SceneError(f"scene.json: model.gaits names {unknown[0]!r}, which is no actor of the scene")
    first, cycles = np.arange(len(number), dtype=np.int32), np.zeros(len(number))
    walkers = np.array([number[uid] for uid, _ in config.gaits], np.int64)
    first[walkers] = len(number) + GAIT_BINS * np.arange(len(walkers))
    cycles[walkers] = [cycle_m for _, cycle_m in config.gaits]
    return GaitRows(first, cycles, np.concatenate([np.arange(len(number)), np.repeat(walkers, GAIT_BINS)]))


def perceptrons(config: ModelConfig) -> dict[str, Perceptron]:
    """Return the model's perceptrons by name. The hypernetwork is for training alone; a scene's file has its output."""
    f, hidden = config.features, config.hidden
    static, background, actor = config.static_grid, config.background_grid, config.actor_grid
    networks = {
        "static.network": Perceptron(static.levels * static.features, hidden, 1 + f),
        "background.network": Perceptron(background.levels * background.features, hidden, 1 + f),
        "actors.network": Perceptron(actor.levels * actor.features, hidden, 1 + f),
        "lidar_head.network": Perceptron(f + SH_WIDTH + LIDAR_INPUTS, hidden, LIDAR_OUTPUTS, 3),
    }
    if config.actors == "latent":
        networks["actors.network"] = Perceptron(3 + 6 * LATENT_OCTAVES + config.latent, hidden, 1 + f, LATENT_LAYERS)
    if config.actors == "hypernetwork":
        own = math.prod(actor_row(config))
        networks["actors.hypernetwork"] = Perceptron(config.latent, config.hyper_hidden, own, config.hyper_layers)
    if config.light == "ground":
        networks["light.network"] = Perceptron(f, LIGHT_HIDDEN, 2 * f)
    if config.colour == "sample":
        networks["colour_head.network"] = Perceptron(f + SH_WIDTH, hidden, 3, 3)
    elif config.head == "sample":
        networks["sample_head"] = Perceptron(f + SH_WIDTH, hidden, f, 3)
    if config.colour == "decoded":
        networks["ray_head.network"] = Perceptron(f + SH_WIDTH + CAMERA_CODE_SIZE, hidden, config.decoder_channels)
    return networks


def convolutions(config: ModelConfig) -> dict[str, Convolution]:
    """Return the camera decoder's convolutions by name, first to last: two per residual block, and the one to
    pixels."""
    if config.colour != "decoded":
        return {}
    c, k = config.decoder_channels, config.decoder_kernel
    blocks = {
        f"blocks.{i}.{part}": Convolution(c, c, k) for i in range(config.decoder_blocks) for part in ("first", "second")
    }
    return {**blocks, "last": Convolution(c, 3 * config.upsample**2, min(k, 3))}


def decoder_reach(config: ModelConfig) -> int:
    """Return the largest distance, in cells, of a feature cell that an output pixel of the camera decoder depends
    on."""
    return sum(convolution.kernel // 2 for convolution in convolutions(config).values())


def camera_codes(cameras: int) -> TensorShape:
    """Return the shape of the codes of ``cameras`` cameras; there is one code where no camera was trained."""
    return max(cameras, 1), CAMERA_CODE_SIZE


def cells_of(size_m: FloatArray, cell_m: float) -> TensorShape:
    """Return the numbers of cells with edges of ``cell_m`` that cover edges of ``size_m`` (3,)."""
    return tuple(math.ceil(edge / cell_m) for edge in size_m.tolist())


def stored_arrays(config: ModelConfig, size_m: FloatArray, actors: int, cameras: int) -> dict[str, TensorShape]:
    """Return the shapes of the arrays of a trained scene's weights by name, for numbers of actors and cameras; see
    `stored_voxels` for the others."""
    networks = perceptrons(config)
    networks.pop("actors.hypernetwork", None)
    actors = 0 if config.actors == "none" else actors
    static, background = static_grid(config, size_m), background_grid(config)
    arrays: dict[str, TensorShape] = {
        "log_beta": (),
        "static.grid.table": (static.rows, static.features),
        "background.grid.table": (background.rows, background.features),
        "actors.tables": (actors, *actor_row(config)),
        "ground.heights": cells_of(size_m[:2], GROUND_CELL_M),
    }
    if config.gaits:
        arrays["actors.gaits.tables"] = (len(config.gaits), 2 * GAIT_HARMONICS, *actor_row(config))
    if config.light == "ground":
        arrays["light.home"] = (actors, 3)
    if config.colour == "decoded":
        arrays["ray_head.codes"] = camera_codes(cameras)
    parts: Mapping[str, Perceptron | Convolution] = {
        **networks, **{f"camera_decoder.{name}": convolution for name, convolution in convolutions(config).items()}
    }  # fmt: skip
    for name, part in parts.items():
        arrays |= part.arrays(name)
    return arrays


def stored_voxels(config: ModelConfig, size_m: FloatArray) -> dict[str, TensorShape]:
    """Return the shapes of the voxel grids of a trained scene's weights by name: the file has their entries that are
    not 0."""
    return dict.fromkeys(("occupancy.values", "observed"), cells_of(size_m, config.voxel_m))


def scene_struct(config: ModelConfig, size_m: FloatArray, **members: Any) -> SceneStruct:
    """Return the structure that the kernels read of a scene in a volume of edges ``size_m`` (3,): what follows from these,
    and other ``members``, the addresses of arrays among them."""
    cells, ground = cells_of(size_m, config.voxel_m), cells_of(size_m[:2], GROUND_CELL_M)
    return SceneStruct(
        size=(ctypes.c_float * 3)(*map(float, size_m)), background_radius_m=float(min(size_m[:2]) / 2),
        background_far_m=config.far_m, unisim_density=int(config.density == "unisim"),
        density_step_m=config.unisim_step_m, voxel_shape=(ctypes.c_int32 * 3)(*cells), voxel_m=config.voxel_m,
        decay_per_m=DECAY_PER_M, ground_shape=(ctypes.c_int32 * 2)(*ground), ground_m=GROUND_CELL_M,
        ground_clearance_m=GROUND_CLEARANCE_M, **members,
    )  # fmt: skip


MAX_NUMBER = 1 << 24
"""Largest number of a configuration: a larger one is broken, and would fill the memory."""
MAX_BY_NAME = {
    "levels": 64, "log2_table": 28, "hidden": 1024, "features": 1024, "latent": 4096, "hyper_hidden": 4096,
    "hyper_layers": 16,
    "decoder_channels": 1024, "decoder_blocks": 64, "decoder_kernel": 31, "upsample": 16,
    **dict.fromkeys(("static_proposals", "static", "actor_proposals", "actor", "background_proposals", "background"),
    1 << 16),
}  # fmt: skip
"""Largest values of whole numbers by their name."""
MIN_BY_NAME = {"coarsest": 1e-3, "finest": 1e-3, "voxel_m": 1e-3}
MAX_ENTRIES = 1 << 27
"""Largest number of entries of all tables and networks: some ten times that of the largest preset."""
MAX_VOXELS = 1 << 28
"""Largest number of voxels, that of a volume of 900 by 900 metres in voxels of half a metre; each takes two bytes of a
rendered scene."""


def check_config(config: Any, where: str) -> None:
    """Check a configuration's numbers and words (a dataclass, nested ones included). SceneError names ``where``
    and the value."""
    hints = get_type_hints(type(config))
    for field in dataclasses.fields(config):
        value, kind, place = getattr(config, field.name), hints[field.name], f"{where}.{field.name}"
        if dataclasses.is_dataclass(value):
            check_config(value, place)
        elif get_origin(kind) is Literal:
            if value not in get_args(kind):
                raise SceneError(f"{place} is {short(value)}, not one of {', '.join(map(repr, get_args(kind)))}")
        elif kind is int:
            most = MAX_BY_NAME.get(field.name, MAX_NUMBER)
            if not (isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= most):
                raise SceneError(f"{place} is {short(value)}, not a whole number from 1 to {most}")
        elif kind is float:
            sound = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
            if not (sound and 0 < value <= MAX_NUMBER):
                raise SceneError(f"{place} is {short(value)}, not a number above 0 and up to {MAX_NUMBER}")
            if value < MIN_BY_NAME.get(field.name, 0):
                raise SceneError(f"{place} is {short(value)}, below {MIN_BY_NAME[field.name]:g}")


def check_sizes(config: ModelConfig, volume: Volume, where: str) -> None:
    """Check that a model of a checked configuration fits into memory. SceneError names ``where``."""
    for name in ("background_grid", "actor_grid"):
        grid = getattr(config, name)
        if min(grid.coarsest, grid.finest) < 1:
            raise SceneError(
                f"{where}.{name} has {min(grid.coarsest, grid.finest):g} cells along an axis, not one at least"
            )
    shapes = {
        "static_grid": static_grid(config, volume.size_m),
        "background_grid": background_grid(config),
        "actor_grid": actor_grid(config),
    }
    entries = {name: shape.rows * shape.features for name, shape in shapes.items()}
    # a hypernetwork's last layer has a row for each of them
    entries["actor_grid"] *= config.hyper_hidden if config.actors == "hypernetwork" else 1
    entries["gaits"] = len(config.gaits) * GAIT_BINS * shapes["actor_grid"].rows * shapes["actor_grid"].features
    entries["voxel_m"] = math.prod(cells_of(volume.size_m, config.voxel_m))
    widest = max(shape.width for shape in shapes.values())
    entries["hidden"] = config.hidden * (widest + config.features) + config.hyper_hidden**2 * config.hyper_layers
    entries["decoder_channels"] = config.decoder_blocks * config.decoder_channels**2 * config.decoder_kernel**2
    for name, count in entries.items():
        most = MAX_VOXELS if name == "voxel_m" else MAX_ENTRIES
        if count > most:
            raise SceneError(f"{where}.{name} asks for {count} numbers in all, more than the {most} that are read")
