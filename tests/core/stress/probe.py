"""What the kernels' headers compute, one function at a time: `native_probe.cpp`, compiled for an instruction set."""

from __future__ import annotations

import ctypes
import functools
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core import native
from unisim_blender.core.render.tracers.compiled.structs import address

Array = NDArray[np.float32]


@functools.cache
def probed(variant: str = "") -> ctypes.CDLL | None:
    """`native_probe.cpp` for an instruction set, the one in use if none is named; None without the kernels."""
    if native.library() is None:
        return None
    variant = variant or native.variant()
    avx2 = ["-march=x86-64-v2", "-mavx2", "-mfma", "-mf16c"]
    flags = {"avx2": avx2, "avx512": [*avx2, "-mavx512f", "-mavx512dq", "-mavx512bw", "-mavx512vl"]}.get(variant, [])
    source = Path(__file__).parent / "native_probe.cpp"
    out = Path(tempfile.mkdtemp(prefix="probe-")) / "probe.so"
    include = f"-I{source.parents[3] / 'native'}"
    subprocess.run(["c++", "-std=c++17", "-O3", "-shared", "-fPIC", *flags, include, source, "-o", out], check=True)
    library = ctypes.CDLL(str(out))
    p, i32, i64 = ctypes.c_void_p, ctypes.c_int, ctypes.c_int64
    for name in ("exp", "softplus", "opacity", "log1p"):
        getattr(library, f"probe_{name}").argtypes = [p, p, i64]
    library.probe_merge.argtypes, library.probe_merge.restype = [i32, i32, p, p, p, p], ctypes.c_float
    library.probe_weights.argtypes = [i32, i32, p, p, p, p, p]
    library.probe_depths.argtypes = [i32, i32, p, p, ctypes.c_float, i32, p, p]
    return library


def ask(library: ctypes.CDLL, name: str, x: Array) -> Array:
    """A function of simd.h at x (n)."""
    padded = np.zeros(-(-len(x) // library.probe_lanes()) * library.probe_lanes(), np.float32)
    padded[: len(x)] = x
    out = np.empty_like(padded)
    getattr(library, f"probe_{name}")(address(padded), address(out), len(padded))
    return out[: len(x)]
