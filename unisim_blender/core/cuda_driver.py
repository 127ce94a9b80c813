"""CUDA's driver, loaded with ctypes: memory and launches of kernels on a GPU, without torch or CUDA's toolkit.

`native/cuda/kernels.cu` is the source of the kernels, `_unisim_cuda.fatbin` beside this file what CUDA's compiler makes
of it (`make cuda`).
"""

from __future__ import annotations

import ctypes
import functools
import sys
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import UnisimError

KERNELS = Path(__file__).parent / "_unisim_cuda.fatbin"
LIBRARY = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"
"""The driver's own library, which a machine with a GPU has."""
OUT_OF_MEMORY = 2
"""The driver's number of the error that its memory does not suffice."""


class GpuMemoryError(UnisimError):
    """A GPU's memory does not suffice."""


@functools.cache
def driver() -> ctypes.CDLL | None:
    """The driver; None where there is none, or no GPU."""
    try:
        library = ctypes.CDLL(LIBRARY)
    except OSError:
        return None
    count = ctypes.c_int()
    p, size = ctypes.c_void_p, ctypes.c_size_t
    library.cuMemFree_v2.argtypes = [p]
    library.cuMemcpyHtoD_v2.argtypes = [p, p, size]
    library.cuMemcpyDtoH_v2.argtypes = [p, p, size]
    library.cuMemsetD8_v2.argtypes = [p, ctypes.c_ubyte, size]
    library.cuLaunchKernel.argtypes = [p, *([ctypes.c_uint] * 7), p, p, p]
    if library.cuInit(0) or library.cuDeviceGetCount(ctypes.byref(count)) or not count.value:
        return None
    return library


def missing() -> str:
    """Return why no GPU traces rays here, in a sentence; "" where one does."""
    if driver() is None:
        return f"no NVIDIA GPU is usable here ({LIBRARY} is absent or finds none)"
    return "" if KERNELS.is_file() else f"{KERNELS} is missing: make cuda compiles it"


class Gpu:
    """A GPU by its number, with the kernels loaded. Raises `UnisimError`."""

    def __init__(self, number: int = 0) -> None:
        library = driver()
        if library is None or missing():
            raise UnisimError(missing())
        self._driver = library
        device, self._context, self._module = ctypes.c_int(), ctypes.c_void_p(), ctypes.c_void_p()
        self.call("cuDeviceGet", ctypes.byref(device), number)
        self.call("cuDevicePrimaryCtxRetain", ctypes.byref(self._context), device)
        self.enter()
        self.call("cuModuleLoadData", ctypes.byref(self._module), KERNELS.read_bytes())
        name = ctypes.create_string_buffer(256)
        self.call("cuDeviceGetName", name, len(name), device)
        self.name = name.value.decode()

    def enter(self) -> None:
        """Have the calling thread use this GPU."""
        self.call("cuCtxSetCurrent", self._context)

    @functools.cache  # noqa: B019 as long as the GPU
    def function(self, name: str) -> ctypes.c_void_p:
        function = ctypes.c_void_p()
        self.call("cuModuleGetFunction", ctypes.byref(function), self._module, name.encode())
        return function

    def total_bytes(self) -> int:
        """Return how much memory it has."""
        free, total = ctypes.c_size_t(), ctypes.c_size_t()
        self.call("cuMemGetInfo_v2", ctypes.byref(free), ctypes.byref(total))
        return total.value

    def launch(self, name: str, threads: int, arguments: Sequence[Any], block: int = 128) -> None:
        """Run a kernel in so many threads, a multiple of ``block``, and wait for its end. ``arguments`` are ctypes' values."""
        addresses = (ctypes.c_void_p * len(arguments))(*(ctypes.addressof(value) for value in arguments))
        self.call("cuLaunchKernel", self.function(name), threads // block, 1, 1, block, 1, 1, 0, None, addresses, None)
        self.call("cuCtxSynchronize")

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function of the driver. Raises `GpuMemoryError`, and `UnisimError` for its other errors."""
        if code := getattr(self._driver, name)(*arguments):
            text = ctypes.c_char_p()
            self._driver.cuGetErrorString(code, ctypes.byref(text))
            kind = GpuMemoryError if code == OUT_OF_MEMORY else UnisimError
            raise kind(f"the GPU's driver: {name}: {(text.value or str(code).encode()).decode()}")


@functools.cache
def gpu(number: int = 0) -> Gpu:
    """The GPU of a number, which the process shares. Raises `UnisimError`."""
    return Gpu(number)


class GpuMemory:
    """Memory on a GPU that is freed together: at the end of a `with`, or by `free`."""

    def __init__(self, gpu: Gpu) -> None:
        self.gpu, self._addresses = gpu, list[int]()
        weakref.finalize(self, _free, gpu, self._addresses).atexit = False

    def __enter__(self) -> GpuMemory:
        return self

    def __exit__(self, *_: object) -> None:
        self.free()

    def free(self) -> None:
        _free(self.gpu, self._addresses)

    def allocate(self, size: int, clear: bool = False) -> int:
        """Return the address of so many new bytes; zeros where ``clear``. Raises `GpuMemoryError`."""
        address = ctypes.c_void_p()
        self.gpu.call("cuMemAlloc_v2", ctypes.byref(address), ctypes.c_size_t(max(size, 1)))
        assert address.value is not None
        self._addresses.append(address.value)
        if clear and size:
            self.gpu.call("cuMemsetD8_v2", address, 0, size)
        return address.value

    def upload(self, values: NDArray[Any] | ctypes.Structure | ctypes.Array[Any]) -> int:
        """Return the address of a copy of an array, contiguous, or of a structure."""
        if isinstance(values, np.ndarray):
            assert values.flags.c_contiguous
            source, size = values.ctypes.data, values.nbytes
        else:
            source, size = ctypes.addressof(values), ctypes.sizeof(values)
        address = self.allocate(size)
        if size:
            self.gpu.call("cuMemcpyHtoD_v2", address, source, size)
        return address

    def download(self, address: int, values: NDArray[Any]) -> None:
        """Copy memory on the GPU into an array."""
        assert values.flags.c_contiguous
        if values.nbytes:
            self.gpu.call("cuMemcpyDtoH_v2", values.ctypes.data, address, values.nbytes)


def _free(gpu: Gpu, addresses: list[int]) -> None:
    while addresses:
        gpu.call("cuMemFree_v2", addresses.pop())
