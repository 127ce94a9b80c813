"""A trained scene as the kernels read it: its tables stay memory-mapped, in half precision.

Its cells (native/cells.h) are those that can stop a ray: the trained distance is evaluated once, and the cells are
kept. A finished training stores them with the scene's weights. For a scene without them, or with those of other
kernels, they are computed when it is first opened and kept in the user's cache folder, under a digest of everything
they depend on: the scene and the library to the bit, and the instruction set.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .... import native
from ....errors import OutputError, SceneError, UnisimError
from ....files import cache_folder, partial_file, read_arrays, sha256_of_file
from ....geometry import FloatArray, invert_pose, transform_points
from ....model.config import ModelConfig
from ....model.scene_file import (
    HEADER_NAME,
    WEIGHTS_NAME,
    SceneHeader,
    Weights,
    check_belongs,
    read_scene_header,
    read_weights,
    weights_hash,
)
from ....model.shapes import (
    GAIT_BINS,
    actor_grid,
    background_grid,
    check_config,
    check_sizes,
    gait_basis,
    gait_rows,
    perceptrons,
    scene_struct,
    static_grid,
    stored_arrays,
    stored_voxels,
)
from ....model.volume import Volume
from ....native import FieldStruct, SceneStruct
from ....ops.constants import GROUND_CELL_M, GROUND_LIGHT_RADIUS_M
from ....ops.grid_shape import GridArrays, GridShape
from .decoder import Decoder
from .structs import address, doubles, floats

BOX_CELLS = 16
CELLS_VERSION = 10
"""Version of the kernels' computation of cells: to be raised with the kernels' ABI_VERSION where that changes them."""
MAX_CACHED_SCENES = 64
"""Largest number of scenes whose cells stay in the cache folder."""


class VoxelCells(NamedTuple):
    """``kinds`` (n,): two bits for each of an occupied voxel's eight cells, in the voxels' order; ``boxes``
    (actors, 16, 16, 16) of the actors' boxes."""

    kinds: NDArray[np.uint16]
    boxes: NDArray[np.uint8]


def stored(weights: Weights, header: SceneHeader, voxels: int) -> VoxelCells | None:
    """Return the cells in a scene's weights, for ``voxels`` occupied voxels; None where they are missing or of other
    kernels. Raises `SceneError`."""
    key = weights.arrays.get("cells.key")
    if key is None or key.tobytes() != _key(header):
        return None
    kinds = weights.array("cells.kinds", (voxels,)).view(np.uint16)
    return VoxelCells(kinds, weights.array("cells.boxes", (_box_rows(header), *(BOX_CELLS,) * 3)))


def to_store(cells: VoxelCells, header: SceneHeader) -> dict[str, NDArray[Any]]:
    """Return the arrays that `stored` reads."""
    return {
        "cells.key": np.frombuffer(_key(header), np.uint8),
        "cells.kinds": cells.kinds.view(np.int16),
        "cells.boxes": cells.boxes,
    }


def cached_cells(header: SceneHeader, voxels: int, work_out: Callable[[], VoxelCells]) -> VoxelCells:
    """Return the cells from the user's cache folder, or those of ``work_out``, which are stored there where it can be
    written."""
    identity = [_key(header).hex(), weights_hash(header.path), _library_hash(), native.variant()]
    file = cache_folder() / "cells" / f"{hashlib.sha256(' '.join(identity).encode()).hexdigest()}.npz"
    with suppress(OutputError, KeyError):
        arrays = read_arrays(file, OutputError)
        cells = VoxelCells(arrays["kinds"], arrays["boxes"])
        shapes = (voxels,), (_box_rows(header), *(BOX_CELLS,) * 3)
        if (
            (cells.kinds.shape, cells.boxes.shape) == shapes
            and cells.kinds.dtype == np.uint16
            and cells.boxes.dtype == np.uint8
        ):
            return cells
    cells = work_out()
    with suppress(OutputError, OSError):
        with partial_file(file) as temporary, temporary.open("wb") as stream:
            np.savez(stream, **cells._asdict())
        for old in sorted(file.parent.glob("*.npz"), key=lambda path: path.stat().st_mtime)[:-MAX_CACHED_SCENES]:
            old.unlink(missing_ok=True)
    return cells


def _box_rows(header: SceneHeader) -> int:
    return len(header.drive.actors) + GAIT_BINS * len(header.model.get("gaits", ()))


def _key(header: SceneHeader) -> bytes:
    """Return a digest of what the cells depend on besides the weights and the instruction set."""
    sizes = [header.drive.actors[uid].size_m.tolist() for uid in sorted(header.drive.actors)]
    identity = json.dumps([CELLS_VERSION, header.model, header.volume, sizes], sort_keys=True)
    return hashlib.sha256(identity.encode()).digest()


@functools.cache
def _library_hash() -> str:
    library = native.library()
    return "" if library is None else sha256_of_file(Path(library._name))


SUPPORTED_VALUES = {"density": ("logistic", "unisim"), "colour": ("decoded",), "actors": ("hypernetwork", "tables")}
"""Values of a configuration that the kernels support."""


def not_taken(config: ModelConfig) -> str:
    """Return the values of a configuration that the kernels do not support, in words; "" where they support all."""
    return " and ".join(
        f"{name} {value!r}"
        for name in SUPPORTED_VALUES
        if (value := getattr(config, name)) not in SUPPORTED_VALUES[name]
    )


MAX_BETA = 1e4


class CompiledScene:
    """The structure that kernels read, and the arrays that it points to. It does not change, so threads may share it.

    ``appearances`` are the actors that the rows of its tables belong to, ``cameras`` those of its codes. Raises
    `SceneError` for files that do not fit, `UnisimError` where the kernels were not built.
    """

    def __init__(self, path: str | Path, header: SceneHeader | None = None, new: Weights | None = None) -> None:
        """Load the scene in folder ``path``. ``header`` is its header, where it is read already; ``new`` are its
        weights, where both are yet to be written."""
        library = native.library()
        if library is None:
            raise UnisimError(
                "rendering without torch needs the compiled kernels: run make setup, and leave UNISIM_NATIVE=0 away"
            )
        self.path = Path(path)
        self.header = read_scene_header(self.path) if header is None else header
        self.config = config = ModelConfig.from_dict(self.header.model)
        check_config(config, f"{self.path / HEADER_NAME}: model")
        if unknown := not_taken(config):
            raise SceneError(
                f"{self.path / HEADER_NAME}: model: the compiled kernels do not take {unknown}: torch's tracer does"
            )
        self.volume = volume = Volume.from_dict(self.header.volume)
        check_sizes(config, volume, f"{self.path / HEADER_NAME}: model")
        self.appearances = tuple(sorted(self.header.drive.actors))
        self.cameras = tuple(str(name) for name in self.header.training.get("cameras", ()))
        self._weights = weights = read_weights(self.path / WEIGHTS_NAME) if new is None else new
        size = volume.size_m
        self.gaits = gait_rows(config, self.appearances)
        self._shapes = shapes = stored_arrays(config, size, len(self.appearances), len(self.cameras))
        weights.check_shapes(shapes)
        if new is None:
            check_belongs(self.header)
        self.arrays: list[NDArray[Any]] = []
        """All arrays that the structure points to."""
        voxel_shapes = stored_voxels(config, size)
        shape = voxel_shapes["occupancy.values"]
        voxels = self._voxels = self._keep(weights.voxels("occupancy.values", shape))
        self.observed = weights.voxels("observed", voxel_shapes["observed"])
        clearance = self._keep(np.empty_like(voxels))
        self._ground = self._keep(floats(self._array("ground.heights")))
        self._volume_from_world = invert_pose(volume.world_from_volume)
        light, home = None, None
        if config.light == "ground":
            light = ctypes.pointer(self._network("light.network"))
            home = self._keep(floats(self._array("light.home")[self.gaits.owner]))
        self.decoder = Decoder(weights, config, len(self.cameras))
        self.struct = scene_struct(
            config,
            size,
            static_field=self._field("static.network", "static.grid.table", static_grid(config, size)),
            background=self._field("background.network", "background.grid.table", background_grid(config)),
            actor_fields=self._field("actors.network", "actors.tables", actor_grid(config)),
            volume_from_world=address(self._keep(doubles(self._volume_from_world[:3]))),
            beta=float(min(np.exp(np.float32(self._array("log_beta"))), MAX_BETA)),
            voxels=address(voxels),
            clearance=address(clearance),
            ground=address(self._ground),
            light=light,
            light_home=address(home),
            light_reach_m=GROUND_LIGHT_RADIUS_M,
            sample_head=self.decoder.sample_head,
        )
        occupied = np.flatnonzero(voxels)

        def work_out() -> VoxelCells:
            return self._evaluate_cells(library, occupied, shape)

        if new is not None:
            self.cells = work_out()
        else:
            self.cells = stored(weights, self.header, len(occupied)) or cached_cells(
                self.header, len(occupied), work_out
            )
        cells, box_cells = self._keep(np.zeros(shape, np.uint16)), self._keep(np.ascontiguousarray(self.cells.boxes))
        cells.reshape(-1)[occupied] = self.cells.kinds
        self._cells = cells
        self.struct.cells, self.struct.box_cells = address(cells), address(box_cells)
        closed, counts = (cells > 0).view(np.uint8), np.array(shape, np.int32)
        library.unisim_clearance(address(closed), address(counts), address(clearance))

    def _evaluate_cells(self, library: ctypes.CDLL, occupied: NDArray[np.int64], shape: tuple[int, ...]) -> VoxelCells:
        """Return the cells of the voxels with these numbers, and of the actors' boxes."""
        cells = np.zeros(shape, np.uint16)
        library.unisim_cells(
            ctypes.byref(self.struct), address(occupied), len(occupied), address(cells), native.threads()
        )
        sizes = floats([self.header.drive.actors[uid].size_m for uid in self.appearances]).reshape(-1, 3)
        sizes = np.ascontiguousarray(sizes[self.gaits.owner])
        boxes = np.empty((len(sizes), BOX_CELLS, BOX_CELLS, BOX_CELLS), np.uint8)
        library.unisim_box_cells(
            ctypes.byref(self.struct), address(sizes), len(sizes), address(boxes), native.threads()
        )
        return VoxelCells(cells.reshape(-1)[occupied], boxes)

    @cached_property
    def observed_struct(self) -> SceneStruct:
        """The scene's structure with only the voxels that the recording shows."""
        shown = self.observed > 0
        voxels, cells = (
            self._keep(np.where(shown, array, np.zeros_like(array))) for array in (self._voxels, self._cells)
        )
        clearance = self._keep(np.empty_like(voxels))
        closed, counts = (cells > 0).view(np.uint8), np.array(shown.shape, np.int32)
        library = native.library()
        assert library is not None
        library.unisim_clearance(address(closed), address(counts), address(clearance))
        struct = SceneStruct.from_buffer_copy(self.struct)
        struct.voxels, struct.cells, struct.clearance = address(voxels), address(cells), address(clearance)
        return struct

    def camera_code(self, camera_id: str) -> int:
        """Return the number of a camera's code, -1 for a camera that was not trained."""
        return self.cameras.index(camera_id) if camera_id in self.cameras else -1

    def into_volume(self, points: FloatArray) -> FloatArray:
        """Return world points (N, 3) in volume coordinates."""
        return transform_points(self._volume_from_world, points)

    def height_above_ground(self, points: FloatArray) -> FloatArray:
        """Return the heights (N,), metres, of world points (N, 3) above the ground: bilinear between the cells'
        middles."""
        x, ground = self.into_volume(points), self._ground
        place = np.clip(x[:, :2] / GROUND_CELL_M - 0.5, 0, np.array(ground.shape) - 1)
        i = place.astype(np.int64)
        (u, v), (a, b), (c, d) = (place - i).T, i.T, np.minimum(i + 1, np.array(ground.shape) - 1).T
        near, far = (1 - v) * ground[a, b] + v * ground[a, d], (1 - v) * ground[c, b] + v * ground[c, d]
        return x[:, 2] - ((1 - u) * near + u * far)

    def supported(self, points: FloatArray) -> NDArray[np.bool_]:
        """Return which world points (N, 3) lie where the recording saw something, or beyond the volume: (N,) bool."""
        x = self.into_volume(points)
        outside = ((x < 0) | (x > self.volume.size_m)).any(1)
        cell = np.clip(np.floor(x / self.config.voxel_m), 0, np.array(self.observed.shape) - 1).astype(np.int64)
        return outside | (self.observed[cell[:, 0], cell[:, 1], cell[:, 2]] > 0)

    def _posed(self, rows: NDArray[Any]) -> NDArray[np.float16]:
        """Return the tables of poses (R, rows, features), see `model.actors.Gaits`, of the actors' own ``rows``."""
        tables, count = self._array("actors.gaits.tables"), len(rows)
        posed = np.empty((len(self.gaits.owner) - count, *rows.shape[1:]), np.float16)
        for number, of_actor in enumerate(tables):
            own = rows[self.gaits.owner[count + number * GAIT_BINS]].astype(np.float32)
            waves = np.tensordot(gait_basis().astype(np.float32), of_actor.astype(np.float32), 1)
            posed[number * GAIT_BINS : (number + 1) * GAIT_BINS] = waves + own
        return posed

    def _keep(self, array: Any) -> Any:
        self.arrays.append(array)
        return array

    def _array(self, name: str) -> NDArray[Any]:
        return self._weights.array(name, self._shapes[name])

    def _network(self, name: str) -> native.MlpStruct:
        shape = perceptrons(self.config)[name]
        arrays = [self._keep(floats(self._array(part))) for part in shape.arrays(name)]
        return native.MlpStruct(shape.inputs, shape.hidden, shape.outputs, *map(address, arrays))

    def _field(self, network: str, table_name: str, grid: GridShape) -> FieldStruct:
        table = self._array(table_name)
        if table_name == "actors.tables" and self.config.gaits:
            table = np.concatenate([table, self._posed(table)])
        table = self._keep(table if table.dtype == np.float16 else floats(table))
        arrays = GridArrays(grid)
        self.arrays += arrays.arrays
        return FieldStruct(arrays.struct, address(table), int(table.dtype == np.float16), self._network(network))


def cells_to_store(header: SceneHeader, weights: Weights) -> dict[str, NDArray[Any]]:
    """Return the arrays to store with a scene's weights, so that opening it evaluates nothing; none without kernels,
    and for a scene that cannot be opened."""
    if native.library() is None:
        return {}
    try:
        return to_store(CompiledScene(header.path, header, weights).cells, header)
    except SceneError:
        return {}
