"""A trained scene as the kernels read it: its tables stay where they are mapped from disk, in half precision."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..fields.config import ModelConfig
from ..fields.hash_grid import GridArrays, GridShape
from ..fields.volume import Volume
from ..geometry import FloatArray, invert_pose
from .structs import FieldStruct, SceneStruct, address, doubles, floats

Weights = Mapping[str, NDArray[Any]]
"""By their names in `weights.safetensors`."""
DECAY_PER_M = 0.15
GROUND_M = 1.0
GROUND_CLEARANCE_M = 0.1
LIGHT_REACH_M = 0.6
MOST_BETA = 1e4


class CompiledScene:
    """The structure that kernels read, and the arrays that it points to. Never changed once it is made: threads may share it."""

    def __init__(self, weights: Weights, config: ModelConfig, volume: Volume, actors: int) -> None:
        self.config, self.volume = config, volume
        self._kept: list[Any] = []
        library = native.needed()
        size = volume.size_m
        static, far, own = config.static_grid, config.far_grid, config.actor_grid
        extent = (float(size[0]), float(size[1]), float(size[2]))
        grids = {
            "static": GridShape.cubic(extent, static.coarsest, static.finest, static.levels, static.features, static.log2_table),
            "far": GridShape.unit(int(far.coarsest), int(far.finest), far.levels, far.features, far.log2_table),
            "actors": GridShape.unit(int(own.coarsest), int(own.finest), own.levels, own.features, own.log2_table),
        }
        tables = {"static": "static.grid.table", "far": "far.grid.table", "actors": "actors.tables"}
        fields = {name: self._field(weights, name, GridArrays(shape), tables[name]) for name, shape in grids.items()}
        pose = self._keep(doubles(invert_pose(volume.world_from_volume)[:3]))
        shape = tuple(int(np.ceil(s / config.voxel_m)) for s in size)
        self.voxels = self._keep(dense(weights, "occupancy.values", shape))
        clearance = self._keep(np.empty_like(self.voxels))
        library.unisim_clearance(address(self.voxels), address(np.array(shape, np.int32)), address(clearance))
        self.ground = self._keep(floats(weights["ground.heights"]))
        light, home = None, None
        if config.light == "ground":
            light = ctypes.pointer(self._network(weights, "light.network"))
            home = self._keep(floats(weights["light.home"]))
        self.struct = SceneStruct(
            fixed=fields["static"],
            far=fields["far"],
            actors=fields["actors"],
            volume_from_world=address(pose),
            size=(ctypes.c_float * 3)(*extent),
            far_radius=float(min(size[:2]) / 2),
            far_m=config.far_m,
            beta=float(min(np.exp(np.float32(weights["log_beta"])), MOST_BETA)),
            paper_density=int(config.density == "unisim"),
            step_m=config.unisim_step_m,
            voxels=address(self.voxels),
            clearance=address(clearance),
            voxel_shape=(ctypes.c_int32 * 3)(*shape),
            voxel_m=config.voxel_m,
            decay_per_m=DECAY_PER_M,
            ground=address(self.ground),
            ground_shape=(ctypes.c_int32 * 2)(*self.ground.shape),
            ground_m=GROUND_M,
            ground_clearance_m=GROUND_CLEARANCE_M,
            light=light,
            light_home=address(home),
            light_reach_m=LIGHT_REACH_M,
        )

    def _keep(self, array: NDArray[Any]) -> NDArray[Any]:
        self._kept.append(array)
        return array

    def _network(self, weights: Weights, name: str) -> native.MlpStruct:
        w1, w2, bias = (self._keep(floats(weights[f"{name}.{part}"])) for part in ("0.weight", "2.weight", "2.bias"))
        return native.MlpStruct(w1.shape[1], len(w1), len(w2), address(w1), address(w2), address(bias))

    def _field(self, weights: Weights, name: str, grid: GridArrays, table_name: str) -> FieldStruct:
        table = weights[table_name]
        half = table.dtype == np.float16
        table = self._keep(table if half and table.flags.c_contiguous else np.ascontiguousarray(table, np.float32))
        self._kept.append(grid)
        return FieldStruct(grid.struct, address(table), int(half), self._network(weights, f"{name}.network"))


def dense(weights: Weights, name: str, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Voxels (X, Y, Z) of which the file holds those that are not 0."""
    values = np.zeros(int(np.prod(shape)), np.uint8)
    values[weights[f"{name}.index"]] = weights[f"{name}.value"]
    return values.reshape(shape)


def height_above(ground: NDArray[np.float32], x: FloatArray) -> FloatArray:
    """How high points (N, 3), volume coordinates, are above the ground (N,): bilinear between the cells' middles."""
    place = np.clip(x[:, :2] / GROUND_M - 0.5, 0, np.array(ground.shape) - 1)
    i = place.astype(np.int64)
    j = np.minimum(i + 1, np.array(ground.shape) - 1)
    (u, v), (a, b), (c, d) = (place - i).T, i.T, j.T
    near = (1 - v) * ground[a, b] + v * ground[a, d]
    return x[:, 2] - ((1 - u) * near + u * ((1 - v) * ground[c, b] + v * ground[c, d]))
