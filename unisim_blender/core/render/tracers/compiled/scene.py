"""A trained scene as the kernels read it: its tables stay where they are mapped from disk, in half precision."""

from __future__ import annotations

import ctypes
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .... import native
from ....errors import SceneError, UnisimError
from ....geometry import FloatArray, invert_pose, transform_points
from ....model.config import GridConfig, ModelConfig
from ....model.config_check import check_config, check_sizes
from ....model.scene_file import HEADER_NAME, WEIGHTS_NAME, SceneHeader, read_scene_header
from ....model.volume import Volume
from ....model.weights import Weights, check_belongs, read_weights
from ....ops.constants import CLEARANCE_M, DECAY_PER_M, GROUND_CELL_M, LIGHT_REACH_M
from ....ops.grid_shape import GridArrays, GridShape
from .cells import BOX_CELLS, Cells, kept, stored, to_store
from .decoder import Decoder
from .structs import FieldStruct, SceneStruct, address, doubles, floats
from .support import not_taken

LIGHT_HIDDEN = 16
MOST_BETA = 1e4


class CompiledScene:
    """The structure that kernels read, and the arrays that it points to. Never changed once it is made: threads may share it.

    ``looks`` are the actors that the rows of its tables belong to, ``cameras`` those that its codes do. Raises `SceneError` for
    files that do not fit, `UnisimError` where the kernels were not built.
    """

    def __init__(self, path: str | Path, new: tuple[SceneHeader, Weights] | None = None) -> None:
        """Opens the scene in folder ``path``; ``new`` are its header and weights where these are yet to be written."""
        library = native.library()
        if library is None:
            raise UnisimError(
                "rendering without torch needs the compiled kernels: run make setup, and leave UNISIM_NATIVE=0 away"
            )
        self.path = Path(path)
        self.header = read_scene_header(self.path) if new is None else new[0]
        self.config = config = ModelConfig.from_dict(self.header.model)
        check_config(config, f"{self.path / HEADER_NAME}: model")
        if unknown := not_taken(config):
            raise SceneError(f"{self.path / HEADER_NAME}: model: the compiled kernels do not take {unknown}: torch's tracer does")
        self.volume = volume = Volume.from_dict(self.header.volume)
        check_sizes(config, volume, f"{self.path / HEADER_NAME}: model")
        self.looks = tuple(sorted(self.header.drive.actors))
        self.cameras = tuple(str(name) for name in self.header.training.get("cameras", ()))
        self._weights = weights = read_weights(self.path / WEIGHTS_NAME) if new is None else new[1]
        if new is None:
            check_belongs(self.header)
        self._kept: list[Any] = []
        size = volume.size_m
        extent = (float(size[0]), float(size[1]), float(size[2]))
        shape = tuple(int(np.ceil(s / config.voxel_m)) for s in size)
        voxels = self._voxels = self._keep(weights.voxels("occupancy.values", shape))
        self.observed = weights.voxels("observed", shape)
        clearance = self._keep(np.empty_like(voxels))
        ground = tuple(int(np.ceil(s / GROUND_CELL_M)) for s in size[:2])
        self._ground = self._keep(floats(weights.array("ground.heights", ground)))
        self._volume_from_world = invert_pose(volume.world_from_volume)
        light, home = None, None
        if config.light == "ground":
            light = ctypes.pointer(self._network("light.network", config.features, LIGHT_HIDDEN, 2 * config.features))
            home = self._keep(floats(weights.array("light.home", (len(self.looks), 3))))
        s = config.static_grid
        static = GridShape.cubic(extent, s.coarsest, s.finest, s.levels, s.features, s.log2_table)
        self.decoder = Decoder(weights, config, len(self.cameras))
        self.struct = SceneStruct(
            fixed=self._field("static", "static.grid.table", static, ()),
            far=self._field("far", "far.grid.table", _unit(config.far_grid), ()),
            actors=self._field("actors", "actors.tables", _unit(config.actor_grid), (len(self.looks),)),
            volume_from_world=address(self._keep(doubles(self._volume_from_world[:3]))),
            size=(ctypes.c_float * 3)(*extent),
            far_radius=float(min(size[:2]) / 2),
            far_m=config.far_m,
            beta=float(min(np.exp(np.float32(weights.array("log_beta", ()))), MOST_BETA)),
            paper_density=int(config.density == "unisim"),
            step_m=config.unisim_step_m,
            voxels=address(voxels),
            clearance=address(clearance),
            voxel_shape=(ctypes.c_int32 * 3)(*shape),
            voxel_m=config.voxel_m,
            decay_per_m=DECAY_PER_M,
            ground=address(self._ground),
            ground_shape=(ctypes.c_int32 * 2)(*ground),
            ground_m=GROUND_CELL_M,
            ground_clearance_m=CLEARANCE_M,
            light=light,
            light_home=address(home),
            light_reach_m=LIGHT_REACH_M,
            sample_head=self.decoder.sample_head,
        )
        occupied = np.flatnonzero(voxels)

        def work_out() -> Cells:
            return self._ask(library, occupied, shape)

        if new is not None:
            self.cells = work_out()
        else:
            self.cells = stored(weights, self.header, len(occupied)) or kept(self.header, len(occupied), work_out)
        cells, box_cells = self._keep(np.zeros(shape, np.uint16)), self._keep(np.ascontiguousarray(self.cells.boxes))
        cells.reshape(-1)[occupied] = self.cells.kinds
        self._cells = cells
        self.struct.cells, self.struct.box_cells = address(cells), address(box_cells)
        closed, counts = (cells > 0).view(np.uint8), np.array(shape, np.int32)
        library.unisim_clearance(address(closed), address(counts), address(clearance))

    def _ask(self, library: ctypes.CDLL, occupied: NDArray[np.int64], shape: tuple[int, ...]) -> Cells:
        """The cells of the voxels with these numbers, and of the actors' boxes."""
        cells = np.zeros(shape, np.uint16)
        library.unisim_cells(ctypes.byref(self.struct), address(occupied), len(occupied), address(cells), native.threads())
        sizes = floats([self.header.drive.actors[uid].size_m for uid in self.looks]).reshape(-1, 3)
        boxes = np.empty((len(self.looks), BOX_CELLS, BOX_CELLS, BOX_CELLS), np.uint8)
        library.unisim_box_cells(ctypes.byref(self.struct), address(sizes), len(sizes), address(boxes), native.threads())
        return Cells(cells.reshape(-1)[occupied], boxes)

    @cached_property
    def observed_struct(self) -> SceneStruct:
        """The same scene with the voxels alone that the recording shows."""
        shown = self.observed > 0
        voxels, cells = (self._keep(np.where(shown, array, np.zeros_like(array))) for array in (self._voxels, self._cells))
        clearance = self._keep(np.empty_like(voxels))
        closed, counts = (cells > 0).view(np.uint8), np.array(shown.shape, np.int32)
        library = native.library()
        assert library is not None
        library.unisim_clearance(address(closed), address(counts), address(clearance))
        struct = SceneStruct.from_buffer_copy(self.struct)
        struct.voxels, struct.cells, struct.clearance = address(voxels), address(cells), address(clearance)
        return struct

    def into_volume(self, points: FloatArray) -> FloatArray:
        """World points (N, 3) in volume coordinates."""
        return transform_points(self._volume_from_world, points)

    def height_above_ground(self, points: FloatArray) -> FloatArray:
        """How high world points (N, 3) are above the ground (N,): bilinear between the cells' middles."""
        x, ground = self.into_volume(points), self._ground
        place = np.clip(x[:, :2] / GROUND_CELL_M - 0.5, 0, np.array(ground.shape) - 1)
        i = place.astype(np.int64)
        (u, v), (a, b), (c, d) = (place - i).T, i.T, np.minimum(i + 1, np.array(ground.shape) - 1).T
        near, far = (1 - v) * ground[a, b] + v * ground[a, d], (1 - v) * ground[c, b] + v * ground[c, d]
        return x[:, 2] - ((1 - u) * near + u * far)

    def supported(self, points: FloatArray) -> NDArray[np.bool_]:
        """Which world points (N, 3) lie where the recording saw something, or beyond the volume: (N,)."""
        x = self.into_volume(points)
        outside = ((x < 0) | (x > self.volume.size_m)).any(1)
        cell = np.clip(np.floor(x / self.config.voxel_m), 0, np.array(self.observed.shape) - 1).astype(np.int64)
        return outside | (self.observed[cell[:, 0], cell[:, 1], cell[:, 2]] > 0)

    def _keep(self, array: Any) -> Any:
        self._kept.append(array)
        return array

    def _network(self, name: str, inputs: int, hidden: int, outputs: int) -> native.MlpStruct:
        shapes = {"0.weight": (hidden, inputs), "2.weight": (outputs, hidden), "2.bias": (outputs,)}
        arrays = [self._keep(floats(self._weights.array(f"{name}.{part}", shape))) for part, shape in shapes.items()]
        return native.MlpStruct(inputs, hidden, outputs, *map(address, arrays))

    def _field(self, name: str, table_name: str, shape: GridShape, grids: tuple[int, ...]) -> FieldStruct:
        table = self._weights.array(table_name, (*grids, shape.rows, shape.features))
        table = self._keep(table if table.dtype == np.float16 else floats(table))
        arrays = self._keep(GridArrays(shape))
        network = self._network(f"{name}.network", shape.width, self.config.hidden, 1 + self.config.features)
        return FieldStruct(arrays.struct, address(table), int(table.dtype == np.float16), network)


def _unit(grid: GridConfig) -> GridShape:
    return GridShape.unit(int(grid.coarsest), int(grid.finest), grid.levels, grid.features, grid.log2_table)


def cells_to_store(header: SceneHeader, weights: Weights) -> dict[str, NDArray[Any]]:
    """What a scene's weights are to hold beside those given, so that opening it asks for nothing; nothing without kernels, and
    for a scene that cannot be opened."""
    if native.library() is None:
        return {}
    try:
        return to_store(CompiledScene(header.path, (header, weights)).cells, header)
    except SceneError:
        return {}
