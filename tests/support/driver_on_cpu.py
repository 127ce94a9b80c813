"""CUDA's driver with a GPU that is the CPU: see `cuda_driver_on_cpu.cpp`."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from unisim_blender.core import cuda_driver
from unisim_blender.core.ops import gpu

SOURCE = Path(__file__).with_name("cuda_driver_on_cpu.cpp")


def build_driver(folder: Path) -> Path:
    """Compile the driver; return its file."""
    library = folder / "libcuda.so.1"
    flags = ["-std=c++17", "-O2", "-shared", "-fPIC", "-fvisibility=hidden"]
    subprocess.run(["g++", *flags, "-o", str(library), str(SOURCE)], check=True)
    return library


@contextmanager
def loaded_driver(built: Path, patch: pytest.MonkeyPatch) -> Iterator[ctypes.CDLL]:
    """Inside, this driver finds a GPU; what is allocated is freed at the end."""
    caches = cuda_driver.driver, cuda_driver.opened_gpu
    kernels = built.parent / "kernels.fatbin"
    kernels.write_bytes(b"of another compiler")
    patch.setattr(cuda_driver, "LIBRARY", str(built))
    patch.setattr(cuda_driver, "KERNELS", kernels)
    for cache in caches:
        cache.cache_clear()
    library = cuda_driver.driver()
    assert library is not None
    library.limit_memory.argtypes, library.memory_in_use.restype = [ctypes.c_size_t], ctypes.c_size_t
    library.limit_memory(1 << 32)
    device = cuda_driver.gpu(0)
    yield library
    device.trim()
    for cache in caches:
        cache.cache_clear()


@contextmanager
def torch_on_driver(patch: pytest.MonkeyPatch) -> Iterator[None]:
    """Inside a loaded driver, the CPU's tensors of float32 are those of the driver's GPU, without torch's CUDA."""
    device = cuda_driver.gpu(0)
    patch.setattr(gpu, "serves", lambda like: like.dtype == torch.float32)
    patch.setattr(cuda_driver, "gpu", lambda number: device)
    patch.setattr(torch.cuda, "device", lambda device: torch.device("cpu"))
    patch.setattr(torch.cuda, "current_stream", lambda: SimpleNamespace(cuda_stream=0))
    yield
