"""The kernels' structures, as native/unisim_native.h has them."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....native import SceneStruct

_P, _I32, _I64, _F32 = ctypes.c_void_p, ctypes.c_int32, ctypes.c_int64, ctypes.c_float


class ActorSetStruct(ctypes.Structure):
    """`unisim_actor_set`."""

    _fields_ = [
        ("scene", ctypes.POINTER(SceneStruct)),
        ("count", _I32),
        ("keys", _I32),
        *(
            (name, _P)
            for name in ("times", "lengths", "positions", "quaternions", "sizes", "start", "end", "rows", "candidates")
        ),
        ("candidate_count", _I32),
        ("scales", _P),
    ]


class ActiveActorsStruct(ctypes.Structure):
    """`unisim_active_actors`."""

    _fields_ = [
        ("actor_sets", ctypes.POINTER(ActorSetStruct)),
        ("actor_set_count", _I32),
        ("copies", ctypes.POINTER(ActorSetStruct)),
        ("world_from_source", _P),
        ("removed_boxes", _I32),
        ("removed_box_from_world", _P),
        ("removed_box_sizes", _P),
    ]


class RaysStruct(ctypes.Structure):
    """`unisim_rays`."""

    _fields_ = [("n", _I64), ("origins", _P), ("directions", _P), ("times", _P), ("order", _P), ("starts", _P)]


class MeshHitsStruct(ctypes.Structure):
    """`unisim_mesh_hits`."""

    _fields_ = [("count", _I64), ("ray", _P), ("t", _P), ("tau", _P), ("normals", _P), ("actor", _P)]


class SamplingStruct(ctypes.Structure):
    """`unisim_sampling`."""

    _fields_ = [
        *((name, _I32) for name in ("proposals", "samples", "actor_proposals", "actor_samples")),
        *((name, _I32) for name in ("background_proposals", "background_samples")),
        ("near_m", _F32),
        ("opaque", _F32),
        ("background_opaque", _F32),
        ("background", _I32),
        ("sky", _I32),
        *((name, _F32) for name in ("stride_m", "step_growth_per_m", "relaxation", "min_slope", "min_step_m")),
        ("splits", _I32),
        ("split_weight", _F32),
    ]


class TraceResultStruct(ctypes.Structure):
    """`unisim_trace_result`."""

    _fields_ = [
        *(
            (name, _P)
            for name in ("feature", "depth", "opacity", "median", "instance", "normal", "feature_without_foreign")
        ),
        *((name, _P) for name in ("foreign_feature", "foreign_opacity", "mesh_opacity", "samples")),
    ]


def address(array: NDArray[Any] | None) -> int | None:
    """Return the address of a contiguous array's numbers, valid while the array is referenced; None for None."""
    assert array is None or array.flags.c_contiguous
    return None if array is None else array.ctypes.data


def floats(values: Any) -> NDArray[np.float32]:
    """Return a contiguous float32 array."""
    return np.ascontiguousarray(values, np.float32)


def doubles(values: Any) -> NDArray[np.float64]:
    """Return a contiguous float64 array."""
    return np.ascontiguousarray(values, np.float64)
