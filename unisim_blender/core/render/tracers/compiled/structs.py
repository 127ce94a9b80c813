"""The kernels' structures, as native/unisim_native.h has them."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....native import GridStruct, MlpStruct

_P, _I32, _I64, _F32 = ctypes.c_void_p, ctypes.c_int32, ctypes.c_int64, ctypes.c_float


class FieldStruct(ctypes.Structure):
    """`unisim_field`."""

    _fields_ = [("grid", GridStruct), ("table", _P), ("half", _I32), ("net", MlpStruct)]


class SceneStruct(ctypes.Structure):
    """`unisim_scene`."""

    _fields_ = [
        ("fixed", FieldStruct),
        ("far", FieldStruct),
        ("actors", FieldStruct),
        ("volume_from_world", _P),
        ("size", _F32 * 3),
        ("far_radius", _F32),
        ("far_m", _F32),
        ("beta", _F32),
        ("paper_density", _I32),
        ("step_m", _F32),
        ("voxels", _P),
        ("clearance", _P),
        ("cells", _P),
        ("box_cells", _P),
        ("voxel_shape", _I32 * 3),
        ("voxel_m", _F32),
        ("decay_per_m", _F32),
        ("ground", _P),
        ("ground_shape", _I32 * 2),
        ("ground_m", _F32),
        ("ground_clearance_m", _F32),
        ("light", ctypes.POINTER(MlpStruct)),
        ("light_home", _P),
        ("light_reach_m", _F32),
        ("sample_head", _P),
    ]


class TroupeStruct(ctypes.Structure):
    """`unisim_troupe`."""

    _fields_ = [
        ("scene", ctypes.POINTER(SceneStruct)),
        ("count", _I32),
        ("keys", _I32),
        *((name, _P) for name in ("times", "lengths", "positions", "quaternions", "sizes", "start", "end", "rows", "among")),
        ("candidates", _I32),
        ("scales", _P),
    ]


class CastStruct(ctypes.Structure):
    """`unisim_cast`."""

    _fields_ = [
        ("troupes", ctypes.POINTER(TroupeStruct)),
        ("troupe_count", _I32),
        ("copies", ctypes.POINTER(TroupeStruct)),
        ("world_from_source", _P),
        ("removals", _I32),
        ("removal_from_world", _P),
        ("removal_sizes", _P),
    ]


class RaysStruct(ctypes.Structure):
    """`unisim_rays`."""

    _fields_ = [("n", _I64), ("origins", _P), ("directions", _P), ("times", _P), ("order", _P), ("starts", _P)]


class MeshHitsStruct(ctypes.Structure):
    """`unisim_mesh_hits`."""

    _fields_ = [("count", _I64), ("ray", _P), ("t", _P), ("tau", _P), ("normals", _P), ("number", _P)]


class SamplingStruct(ctypes.Structure):
    """`unisim_sampling`."""

    _fields_ = [
        *((name, _I32) for name in ("proposals", "samples", "actor_proposals", "actor_samples", "far_proposals", "far_samples")),
        ("near_m", _F32),
        ("opaque", _F32),
        ("far_opaque", _F32),
        ("far", _I32),
        ("sky", _I32),
        *((name, _F32) for name in ("stride_m", "widening", "relaxation", "least_slope", "least_step_m")),
        ("splits", _I32),
        ("split_weight", _F32),
    ]


class FoundStruct(ctypes.Structure):
    """`unisim_found`."""

    _fields_ = [
        *((name, _P) for name in ("feature", "depth", "opacity", "median", "instance", "normal", "own_feature")),
        *((name, _P) for name in ("guest_feature", "guest_opacity", "mesh_opacity", "samples")),
    ]


def address(array: NDArray[Any] | None) -> int | None:
    """Where a contiguous array's numbers lie, as long as somebody holds it; None for none."""
    assert array is None or array.flags.c_contiguous
    return None if array is None else array.ctypes.data


def floats(values: Any) -> NDArray[np.float32]:
    """Contiguous float32."""
    return np.ascontiguousarray(values, np.float32)


def doubles(values: Any) -> NDArray[np.float64]:
    """Contiguous float64."""
    return np.ascontiguousarray(values, np.float64)
