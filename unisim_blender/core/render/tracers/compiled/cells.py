"""The cells of a scene that can stop a ray (native/cells.h): its trained distance is evaluated once, and
the cells are kept.

A finished training stores them with the scene's weights. For a scene without them, or with those of other kernels, they
are computed when it is first opened and kept in the user's cache folder, under a digest of everything they depend on:
the scene and the library to the bit, and the instruction set.
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .... import native
from ....errors import OutputError
from ....files import cache_folder, partial_file, read_arrays, sha256_of_file
from ....model.files.scene_file import SceneHeader
from ....model.files.weights import Weights, weights_hash

BOX_CELLS = 16
CELLS_VERSION = 10
"""Of how the kernels compute cells: to be raised with the kernels' ABI_VERSION where that changes them."""
MOST_KEPT = 64
"""So many scenes' cells stay in the cache folder."""


class VoxelCells(NamedTuple):
    """``kinds`` (n,): two bits for each of an occupied voxel's eight cells, in the voxels' order; ``boxes``
    (actors, 16, 16, 16) of the actors' boxes."""

    kinds: NDArray[np.uint16]
    boxes: NDArray[np.uint8]


def stored(weights: Weights, header: SceneHeader, voxels: int) -> VoxelCells | None:
    """The cells in a scene's weights, for so many occupied voxels; None where they are missing or of other kernels.
    Raises `SceneError`."""
    key = weights.arrays.get("cells.key")
    if key is None or key.tobytes() != _key(header):
        return None
    kinds = weights.array("cells.kinds", (voxels,)).view(np.uint16)
    return VoxelCells(kinds, weights.array("cells.boxes", (len(header.drive.actors), *(BOX_CELLS,) * 3)))


def to_store(cells: VoxelCells, header: SceneHeader) -> dict[str, NDArray[Any]]:
    """The arrays that `stored` finds."""
    return {
        "cells.key": np.frombuffer(_key(header), np.uint8),
        "cells.kinds": cells.kinds.view(np.int16),
        "cells.boxes": cells.boxes,
    }


def kept(header: SceneHeader, voxels: int, work_out: Callable[[], VoxelCells]) -> VoxelCells:
    """The cells from the user's cache folder, where they are left if they are not there and it can be written."""
    told = [_key(header).hex(), weights_hash(header.path), _library_hash(), native.variant()]
    file = cache_folder() / "cells" / f"{hashlib.sha256(' '.join(told).encode()).hexdigest()}.npz"
    with suppress(OutputError, KeyError):
        found = read_arrays(file, OutputError)
        cells = VoxelCells(found["kinds"], found["boxes"])
        shapes = (voxels,), (len(header.drive.actors), *(BOX_CELLS,) * 3)
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
        for old in sorted(file.parent.glob("*.npz"), key=lambda path: path.stat().st_mtime)[:-MOST_KEPT]:
            old.unlink(missing_ok=True)
    return cells


def _key(header: SceneHeader) -> bytes:
    """A digest of what the cells depend on besides the weights and the instruction set."""
    sizes = [header.drive.actors[uid].size_m.tolist() for uid in sorted(header.drive.actors)]
    told = json.dumps([CELLS_VERSION, header.model, header.volume, sizes], sort_keys=True)
    return hashlib.sha256(told.encode()).digest()


@functools.cache
def _library_hash() -> str:
    library = native.library()
    return "" if library is None else sha256_of_file(Path(library._name))
