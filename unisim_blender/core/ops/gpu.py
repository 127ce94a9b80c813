"""The kernels of native/cuda on torch's tensors: launched on torch's current stream, which may be captured as a graph.

They allocate nothing, and nothing waits for them.
"""

from __future__ import annotations

import ctypes
import functools
import os
import warnings
from typing import Any

import torch
from torch import Tensor

from .. import cuda_driver, native
from ..errors import UnisimError
from .grid_shape import GridShape


class EncodedPointsStruct(ctypes.Structure):
    """`EncodedPoints` of native/cuda/training.h."""

    _fields_ = [("grid", native.GridStruct), *native.members(ctypes.c_void_p, "table x number")]


class GatheredSegmentsStruct(ctypes.Structure):
    """`GatheredSegments` of native/cuda/training.h."""

    _fields_ = [
        *native.members(ctypes.c_int64, "n stride"),
        *native.members(ctypes.c_int32, "width length"),
        *native.members(ctypes.c_void_p, "t tau stop_fraction before features"),
    ]


class VoxelRaysStruct(ctypes.Structure):
    """`VoxelRays` of native/cuda/training.h."""

    _fields_ = [
        *native.members(ctypes.c_void_p, "origins directions t_near t_far lower voxels"),
        ("shape", ctypes.c_int32 * 3),
        *native.members(ctypes.c_float, "per_m step decay"),
    ]


def serves(like: Tensor) -> bool:
    """Return whether the kernels run on the GPU of a tensor; UNISIM_NATIVE=0 switches them off."""
    return like.is_cuda and _loads(like.device.index)


@functools.cache
def _loads(number: int) -> bool:
    if os.environ.get("UNISIM_NATIVE") == "0":
        return False
    try:
        cuda_driver.gpu(number)
    except UnisimError as error:
        warnings.warn(f"no kernels run on cuda:{number}, plain torch takes their place, slowly: {error}", stacklevel=2)
        return False
    return True


def launch(kernel: str, like: Tensor, threads: int, *arguments: Any) -> None:
    """Launch a kernel on the GPU of a tensor. ``arguments`` are structures, contiguous tensors, None for a null pointer, and
    integers (int64), or ctypes' values."""
    if not threads:
        return
    values = [_value(argument) for argument in arguments]
    with torch.cuda.device(like.device):
        gpu = cuda_driver.gpu(like.device.index)
        # a thread that torch has not used yet has no context
        gpu.enter()
        gpu.launch(f"unisim_{kernel}", threads, values, stream=torch.cuda.current_stream().cuda_stream)


def _value(argument: Any) -> Any:
    if argument is None or isinstance(argument, Tensor):
        return ctypes.c_void_p(pointer(argument))
    return ctypes.c_int64(argument) if isinstance(argument, int) else argument


def pointer(tensor: Tensor | None) -> int | None:
    """Return the address of a contiguous tensor's values."""
    if tensor is None:
        return None
    assert tensor.is_contiguous()
    return tensor.data_ptr()


def encoded_points(shape: GridShape, table: Tensor, x: Tensor, index: Tensor | None) -> EncodedPointsStruct:
    """Return a table, points (N, 3) and the numbers (N,) int32 of their grids in the form that the kernels read."""
    # rows are read at once
    assert table.data_ptr() % 16 == 0
    arrays = _grid_arrays(shape, x.device)
    grid = native.GridStruct(shape.levels, shape.features, shape.rows, *(array.data_ptr() for array in arrays))
    return EncodedPointsStruct(grid, pointer(table), pointer(x), pointer(index))


@functools.cache
def _grid_arrays(shape: GridShape, device: torch.device) -> tuple[Tensor, ...]:
    """Return a shape's scale, offset, size, stride_y and stride_z on a device, made once."""
    offset, *others = shape.layout()
    arrays = torch.tensor(shape.scale), torch.tensor(offset), *(torch.tensor(x, dtype=torch.int32) for x in others)
    return tuple(array.to(device) for array in arrays)
