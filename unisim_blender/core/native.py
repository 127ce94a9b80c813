"""The compiled kernels, loaded with ctypes. They read and write contiguous CPU arrays; the plain torch or numpy code
beside each call is their specification, and runs where the library is absent."""

from __future__ import annotations

import ctypes
import functools
import os
import sys
import warnings
from pathlib import Path
from typing import Any

from .errors import UnisimError

ABI_VERSION = 16
VARIANT_VARIABLE = "UNISIM_NATIVE_VARIANT"
"""The variable of the environment that chooses the kernels' instruction set."""
_SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


def members(kind: type[Any], names: str) -> list[tuple[str, type[Any]]]:
    """Return members of a structure that are of one kind, by their names with spaces between."""
    return [(name, kind) for name in names.split()]


class GridStruct(ctypes.Structure):
    """`unisim_grid` of native/unisim_native.h."""

    _fields_ = [
        *members(ctypes.c_int32, "levels features"),
        *members(ctypes.c_int64, "grid_stride"),
        *members(ctypes.c_void_p, "scale offset size stride_y stride_z"),
    ]


class MlpStruct(ctypes.Structure):
    """`unisim_mlp` of native/unisim_native.h."""

    _fields_ = [*members(ctypes.c_int32, "inputs hidden outputs"), *members(ctypes.c_void_p, "w1 w2 bias")]


class FieldStruct(ctypes.Structure):
    """`unisim_field` of native/unisim_native.h."""

    _fields_ = [
        ("grid", GridStruct),
        *members(ctypes.c_void_p, "table"),
        *members(ctypes.c_int32, "half"),
        ("net", MlpStruct),
    ]


class SceneStruct(ctypes.Structure):
    """`unisim_scene` of native/unisim_native.h."""

    _fields_ = [
        *members(FieldStruct, "static_field background actor_fields"),
        *members(ctypes.c_void_p, "volume_from_world"),
        ("size", ctypes.c_float * 3),
        *members(ctypes.c_float, "background_radius_m background_far_m beta"),
        *members(ctypes.c_int32, "unisim_density"),
        *members(ctypes.c_float, "density_step_m"),
        *members(ctypes.c_void_p, "voxels clearance cells box_cells"),
        ("voxel_shape", ctypes.c_int32 * 3),
        *members(ctypes.c_float, "voxel_m decay_per_m"),
        *members(ctypes.c_void_p, "ground"),
        ("ground_shape", ctypes.c_int32 * 2),
        *members(ctypes.c_float, "ground_m ground_clearance_m"),
        ("light", ctypes.POINTER(MlpStruct)),
        *members(ctypes.c_void_p, "light_home"),
        *members(ctypes.c_float, "light_reach_m"),
        *members(ctypes.c_void_p, "sample_head"),
    ]


class RaySegmentsStruct(ctypes.Structure):
    """`unisim_ray_segments` of native/unisim_native.h."""

    _fields_ = [
        *members(ctypes.c_int64, "n"),
        *members(ctypes.c_int32, "width"),
        *members(ctypes.c_void_p, "ray t tau stop_fraction"),
    ]


class LayerStruct(ctypes.Structure):
    """`unisim_layer` of native/unisim_native.h."""

    _fields_ = [*members(ctypes.c_int32, "inputs outputs kernel"), *members(ctypes.c_void_p, "weight bias")]


class PlaneStruct(ctypes.Structure):
    """`unisim_plane` of native/unisim_native.h."""

    _fields_ = [*members(ctypes.c_void_p, "values"), *members(ctypes.c_int32, "channels bytes kind")]


class BlockToleranceStruct(ctypes.Structure):
    """`unisim_block_tolerance` of native/unisim_native.h."""

    _fields_ = members(ctypes.c_float, "spread contrast prediction range twist")


class AdamStruct(ctypes.Structure):
    """`unisim_adam_part` of native/unisim_native.h."""

    _fields_ = [
        *members(ctypes.c_int64, "n"),
        *members(ctypes.c_void_p, "value gradient mean square"),
        *members(ctypes.c_float, "rate root eps"),
    ]


class HeadStruct(ctypes.Structure):
    """`unisim_head` of native/unisim_native.h."""

    _fields_ = [*members(ctypes.c_int32, "features extra_inputs count"), *members(ctypes.c_void_p, "layers")]


@functools.cache
def library() -> ctypes.CDLL | None:
    """The kernels, or None (with one warning) where they were not built. UNISIM_NATIVE=0 disables them. Raises `UnisimError`
    where they were built from other sources."""
    if os.environ.get("UNISIM_NATIVE") == "0":
        return None
    path = Path(__file__).parent / f"_unisim_native{_SUFFIX}"
    try:
        lib = ctypes.CDLL(str(path))
    except OSError as error:
        warnings.warn(
            f"the compiled kernels are not at {path} ({error}); plain torch takes their place, slowly", stacklevel=2
        )
        return None
    version = lib.unisim_abi_version()
    if version != ABI_VERSION:
        raise UnisimError(
            f"{path} was built from other sources (version {version}, these have {ABI_VERSION}): run make setup, or set "
            "UNISIM_NATIVE=0 for plain torch, which is ten times slower"
        )
    p, i64, i32, f32, f64 = ctypes.c_void_p, ctypes.c_int64, ctypes.c_int, ctypes.c_float, ctypes.c_double
    lib.unisim_variant.restype = ctypes.c_char_p
    lib.unisim_encode_forward.argtypes = [p, p, p, i64, p, p, i32]
    lib.unisim_encode_backward_table.argtypes = [p, p, p, i64, p, p, i32]
    lib.unisim_encode_backward_input.argtypes = [p, p, p, i64, p, p, p, i32]
    lib.unisim_propose.argtypes = [p, p, p, p, i64, p, p, p, p, f32, f32, p, i32, p, p, i32]
    lib.unisim_refine.argtypes = [p, p, p, i64, i32, f32, f32, p, i32, p, i32]
    lib.unisim_place_static.argtypes = [p, p, p, p, p, i64, p, p, p, i64, p, i32, f32, p, i32, p, p, i32]
    lib.unisim_place_background.argtypes = [p, p, p, p, i64, p, i32, p, i32, p, p, i32]
    lib.unisim_mlp_forward.argtypes = [p, p, i64, p, i32]
    lib.unisim_mlp_backward.argtypes = [p, p, i64, p, p, p, p, p, i32]
    lib.unisim_adam.argtypes = [p, i32, f32, f32, i32]
    lib.unisim_field_forward.argtypes = [p, p, p, i64, p, p, p, i32]
    lib.unisim_near_spheres.argtypes = [p, p, p, i64, p, p, i64, p, i32]
    lib.unisim_intervals_forward.argtypes = [p, i64, i32, f32, p, p, i32]
    lib.unisim_intervals_backward.argtypes = [p, i64, i32, f32, p, p, p, p, i32]
    lib.unisim_transmittances_forward.argtypes = [p, i32, i64, p, i32]
    lib.unisim_transmittances_backward.argtypes = [p, i32, i64, p, p, p, i32]
    lib.unisim_gather_forward.argtypes = [p, p, p, i64, i32, p, p, p, i32]
    lib.unisim_gather_backward.argtypes = [p, p, p, i64, i32, p, p, p, p, p, p, p, p, i32]
    lib.unisim_bvh_build.argtypes = [p, p, i32, p, p]
    lib.unisim_bvh_first_hits.argtypes = [p, p, p, p, p, p, i64, f64, p, p, p, i32]
    lib.unisim_local_planes.argtypes = [p, p, p, i64, p, p, f64, i32, p, i64, p, p, p, p, p, i32]
    lib.unisim_trace.argtypes = [p, p, p, p, p, p, i32]
    lib.unisim_march.argtypes = [p, i32, p, p, p, p, p, i64, p, p, i32, p, p, p]
    lib.unisim_clearance.argtypes = [p, p, p]
    lib.unisim_first_marked.argtypes = [p, p, i64, f64, p, p, p, f64, p, i32]
    lib.unisim_cells.argtypes = [p, p, i64, p, i32]
    lib.unisim_box_cells.argtypes = [p, p, i32, p, i32]
    lib.unisim_blocks_differ.argtypes = [p, i32, p, i64, i64, i32, p, p, i32]
    lib.unisim_blocks_predicted.argtypes = [p, i32, p, i64, i64, i32, p, p, i32]
    lib.unisim_blocks_fill.argtypes = [p, i32, p, i64, i64, i32, p, i32]
    lib.unisim_head_forward.argtypes = [p, p, p, p, i64, p, i32]
    lib.unisim_decode_image.argtypes = [p, p, i32, i32, p, p, i32, i32, p, i32, i32]
    return lib


def threads() -> int:
    """How many threads a kernel uses where torch does not decide."""
    return int(os.environ.get("OMP_NUM_THREADS") or os.cpu_count() or 1)


def variant() -> str:
    """The instruction set in use: avx512, avx2, portable, or "torch" without the library."""
    lib = library()
    return "torch" if lib is None else lib.unisim_variant().decode()


def has_half() -> bool:
    """Whether the kernels can multiply bfloat16 here."""
    lib = library()
    return lib is not None and bool(lib.unisim_has_half())
