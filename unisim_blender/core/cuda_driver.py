"""CUDA's driver, loaded with ctypes: memory and launches of kernels on a GPU, without torch or CUDA's toolkit.

`native/cuda/kernels.cu` is the source of the kernels, `_unisim_cuda.fatbin` beside this file what CUDA's compiler makes
of it (`make cuda`). Where that file is absent, NVRTC compiles the source for the GPU at hand, if it is installed.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import sys
import weakref
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import OutputError, UnisimError
from .files import cache_folder, write_file

KERNELS = Path(__file__).parent / "_unisim_cuda.fatbin"
SOURCE = next(
    (
        path
        for path in (Path(__file__).parent / "native_source", Path(__file__).parents[2] / "native")
        if (path / "cuda" / "kernels.cu").is_file()
    ),
    None,
)
"""The folder of the kernels' source, in a wheel or in the repository."""
NVRTC_FILES = ("nvidia/*/lib/libnvrtc.so.*", "nvidia/*/bin/nvrtc64_*_0.dll", "nvidia/*/bin/*/nvrtc64_*_0.dll")
"""Where packages have NVRTC."""
NVRTC_HEADER = """
typedef signed char int8_t; typedef unsigned char uint8_t; typedef short int16_t; typedef unsigned short uint16_t;
typedef int int32_t; typedef unsigned int uint32_t; typedef long long int64_t; typedef unsigned long long uint64_t;
#define HUGE_VALF __int_as_float(0x7f800000)
namespace std {
using ::asin; using ::ceil; using ::cos; using ::exp; using ::expm1; using ::fabs; using ::floor; using ::fmax; using ::fmin;
using ::log; using ::log1p; using ::sin; using ::sqrt;
template <class T> __host__ __device__ constexpr const T &min(const T &a, const T &b) { return b < a ? b : a; }
template <class T> __host__ __device__ constexpr const T &max(const T &a, const T &b) { return a < b ? b : a; }
}
"""
"""What NVRTC lacks of C++'s own headers."""
LIBRARY = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"
"""The driver's own library, which a machine with a GPU has."""
NON_BLOCKING, NO_TIMES = 1, 2
"""The driver's flags of a stream that waits for no other, and of an event that measures nothing."""
BLOCK = 128
"""Threads of a block."""
CAPABILITY = 75, 76
"""The driver's numbers of what a compute capability is made of."""
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
    library.cuMemcpyDtoHAsync_v2.argtypes = library.cuMemcpyHtoDAsync_v2.argtypes = [p, p, size, p]
    library.cuStreamWaitEvent.argtypes, library.cuEventRecord.argtypes = [p, p, ctypes.c_uint], [p, p]
    library.cuEventSynchronize.argtypes = [p]
    library.cuMemsetD8_v2.argtypes = [p, ctypes.c_ubyte, size]
    library.cuLaunchKernel.argtypes = [p, *([ctypes.c_uint] * 7), p, p, p]
    if library.cuInit(0) or library.cuDeviceGetCount(ctypes.byref(count)) or not count.value:
        return None
    return library


def missing() -> str:
    """Return what a GPU lacks here to trace rays, in a sentence; "" where nothing is missing. It opens no GPU."""
    if driver() is None:
        return f"no NVIDIA GPU is usable here ({LIBRARY} is absent or finds none)"
    if KERNELS.is_file() or (SOURCE is not None and nvrtc() is not None):
        return ""
    return (
        f"{KERNELS} is missing: make cuda compiles it, or NVRTC (pip install nvidia-cuda-nvrtc), which is not installed"
    )


@functools.cache
def nvrtc() -> ctypes.CDLL | None:
    """CUDA's compiler as a library, of a package or the system's; None where there is none."""
    packages = (
        str(path) for folder in sys.path for name in NVRTC_FILES for path in sorted(Path(folder or ".").glob(name))
    )
    for name in (*packages, "libnvrtc.so.13", "libnvrtc.so.12", "nvrtc64_130_0.dll", "nvrtc64_120_0.dll"):
        with suppress(OSError, AttributeError):
            library = ctypes.CDLL(name)
            _ = library.nvrtcGetCUBIN  # CUDA 11.1 has it
            return library
    return None


def compiled(capability: str) -> bytes:
    """Return the kernels' machine code for a compute capability, such as "90", by NVRTC, or from the user's cache folder. It
    takes a minute. Raises `UnisimError`."""
    library = nvrtc()
    assert library is not None and SOURCE is not None
    text = NVRTC_HEADER + _with_includes(SOURCE / "cuda" / "kernels.cu", set())
    file = cache_folder() / "cuda" / f"{hashlib.sha256(f'{capability} {text}'.encode()).hexdigest()}.cubin"
    if file.is_file():
        return file.read_bytes()
    program, size = ctypes.c_void_p(), ctypes.c_size_t()
    library.nvrtcCreateProgram(ctypes.byref(program), text.encode(), b"kernels.cu", 0, None, None)
    options = [f"--gpu-architecture=sm_{capability}".encode(), b"--std=c++17"]
    if library.nvrtcCompileProgram(program, len(options), (ctypes.c_char_p * len(options))(*options)):
        library.nvrtcGetProgramLogSize(program, ctypes.byref(size))
        log = ctypes.create_string_buffer(size.value)
        library.nvrtcGetProgramLog(program, log)
        raise UnisimError(f"NVRTC does not compile the kernels for capability {capability}: {log.value.decode()[:500]}")
    library.nvrtcGetCUBINSize(program, ctypes.byref(size))
    code = ctypes.create_string_buffer(size.value)
    library.nvrtcGetCUBIN(program, code)
    with suppress(OutputError, OSError):
        write_file(file, code.raw)
    return code.raw


def _with_includes(path: Path, seen: set[Path]) -> str:
    """Return a source with the project's own headers in place; the language's are left out."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith('#include "'):
            header = (path.parent / line.split('"')[1]).resolve()
            if header not in seen:
                seen.add(header)
                lines.append(_with_includes(header, seen))
        elif not line.startswith(("#include", "#pragma once")):
            lines.append(line)
    return "\n".join(lines) + "\n"


def count() -> int:
    """Return how many GPUs there are."""
    number, library = ctypes.c_int(), driver()
    if library is not None:
        library.cuDeviceGetCount(ctypes.byref(number))
    return number.value


class Gpu:
    """A GPU by its number, with the kernels loaded. Raises `UnisimError`."""

    def __init__(self, number: int) -> None:
        library = driver()
        if library is None or missing():
            raise UnisimError(missing())
        if not 0 <= number < count():
            raise UnisimError(
                f"--device cuda:{number}: there is no such GPU; this machine has {count()}, from cuda:0 on"
            )
        self._driver = library
        device, self._context, self._module = ctypes.c_int(), ctypes.c_void_p(), ctypes.c_void_p()
        self.call("cuDeviceGet", ctypes.byref(device), number)
        self.call("cuDevicePrimaryCtxRetain", ctypes.byref(self._context), device)
        self.enter()
        self._load(device)
        name = ctypes.create_string_buffer(256)
        self.call("cuDeviceGetName", name, len(name), device)
        self.name = name.value.decode()
        self._copies = ctypes.c_void_p()
        self.call("cuStreamCreate", ctypes.byref(self._copies), NON_BLOCKING)
        self._events: list[ctypes.c_void_p] = []
        self._held_bytes = self.peak_bytes = 0
        """The most that was allocated of its memory at a time, bytes."""
        self._spare: dict[int, list[int]] = {}
        self._spare_pinned: dict[int, list[int]] = {}

    def _load(self, device: ctypes.c_int) -> None:
        """Load the file of `make cuda`; where it is absent, or has no code for this GPU, what NVRTC compiles."""
        if KERNELS.is_file():
            try:
                return self.call("cuModuleLoadData", ctypes.byref(self._module), KERNELS.read_bytes())
            except GpuMemoryError:
                raise
            except UnisimError as error:
                if SOURCE is None or nvrtc() is None:
                    raise UnisimError(f"{KERNELS} does not run on this GPU: {error}") from error
        self.call("cuModuleLoadData", ctypes.byref(self._module), compiled(self._capability(device)))

    def _capability(self, device: ctypes.c_int) -> str:
        number = ctypes.c_int()
        digits = []
        for attribute in CAPABILITY:
            self.call("cuDeviceGetAttribute", ctypes.byref(number), attribute, device)
            digits.append(str(number.value))
        return "".join(digits)

    def enter(self) -> None:
        """Have the calling thread use this GPU."""
        self.call("cuCtxSetCurrent", self._context)

    @functools.cache  # noqa: B019 as long as the GPU
    def function(self, name: str) -> ctypes.c_void_p:
        function = ctypes.c_void_p()
        self.call("cuModuleGetFunction", ctypes.byref(function), self._module, name.encode())
        return function

    def memory_bytes(self) -> tuple[int, int]:
        """Return how much of its memory is free, and how much there is."""
        free, total = ctypes.c_size_t(), ctypes.c_size_t()
        self.call("cuMemGetInfo_v2", ctypes.byref(free), ctypes.byref(total))
        return free.value, total.value

    def launch(
        self, name: str, threads: int, arguments: Sequence[Any], block: int = BLOCK, stream: int | None = None
    ) -> None:
        """Have a kernel run in at least so many threads, after what was launched before in its stream. ``arguments`` are
        ctypes' values. An error of a kernel is raised by a later call."""
        addresses = (ctypes.c_void_p * len(arguments))(*(ctypes.addressof(value) for value in arguments))
        blocks = -(-threads // block)
        self.call("cuLaunchKernel", self.function(name), blocks, 1, 1, block, 1, 1, 0, stream, addresses, None)

    def allocate(self, size: int) -> int:
        """Return the address of so many bytes, of memory that was given back where there is some of that size. Raises
        `GpuMemoryError`."""
        if spare := self._spare.get(size):
            return spare.pop()
        address = ctypes.c_void_p()
        try:
            self.call("cuMemAlloc_v2", ctypes.byref(address), ctypes.c_size_t(size))
        except GpuMemoryError as error:
            if not self.trim():
                free, total = self.memory_bytes()
                raise GpuMemoryError(
                    f"{self.name}: out of memory: {size / 2**20:.1f} MiB are wanted, {free / 2**20:.1f} of "
                    f"{total / 2**20:.0f} MiB are free; close what else uses the GPU, or render on the CPU"
                ) from error
            return self.allocate(size)
        assert address.value is not None
        self._held_bytes += size
        self.peak_bytes = max(self.peak_bytes, self._held_bytes)
        return address.value

    def give_back(self, address: int, size: int) -> None:
        """Keep memory for later calls of `allocate`."""
        self._spare.setdefault(size, []).append(address)

    def trim(self) -> bool:
        """Free the memory that was given back; return whether there was some."""
        spare, self._spare = self._spare, {}
        for size, addresses in spare.items():
            for address in addresses:
                self.free(address, size)
        return any(spare.values())

    def free(self, address: int, size: int) -> None:
        """Free memory of so many bytes."""
        self.call("cuMemFree_v2", address)
        self._held_bytes -= size

    def pinned(self, shape: tuple[int, ...], kind: type[Any]) -> NDArray[Any]:
        """Return a new array of the host's memory that a GPU copies to at full speed, of memory that earlier ones no longer
        use where there is some."""
        size = rounded(int(np.prod(shape)) * np.dtype(kind).itemsize)
        if spare := self._spare_pinned.get(size):
            address = spare.pop()
        else:
            place = ctypes.c_void_p()
            self.call("cuMemAllocHost_v2", ctypes.byref(place), ctypes.c_size_t(size))
            assert place.value is not None
            address = place.value
        memory = (ctypes.c_char * size).from_address(address)
        weakref.finalize(memory, self._spare_pinned.setdefault(size, []).append, address).atexit = False
        return np.frombuffer(memoryview(memory), kind, int(np.prod(shape))).reshape(shape)

    def copy(self, copies: Iterable[tuple[int, NDArray[Any]]]) -> ctypes.c_void_p:
        """Have memory of the GPU copied into `pinned` arrays, after what was launched and beside what is launched later. Return
        the event for `wait`, until which neither is free for anything else."""
        if not self._events:
            self._events.append(ctypes.c_void_p())
            self.call("cuEventCreate", ctypes.byref(self._events[-1]), NO_TIMES)
        event = self._events.pop()
        self.call("cuEventRecord", event, None)
        self.call("cuStreamWaitEvent", self._copies, event, 0)
        for address, values in copies:
            if values.nbytes:
                self.call("cuMemcpyDtoHAsync_v2", values.ctypes.data, address, values.nbytes, self._copies)
        self.call("cuEventRecord", event, self._copies)
        return event

    def wait(self, event: ctypes.c_void_p) -> None:
        """Wait until what `copy` began is there."""
        self.call("cuEventSynchronize", event)
        self._events.append(event)

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function of the driver. Raises `GpuMemoryError`, and `UnisimError` for its other errors."""
        if code := getattr(self._driver, name)(*arguments):
            text = ctypes.c_char_p()
            self._driver.cuGetErrorString(code, ctypes.byref(text))
            kind = GpuMemoryError if code == OUT_OF_MEMORY else UnisimError
            raise kind(f"the GPU's driver: {name}: {(text.value or str(code).encode()).decode()}")


def gpu(number: int) -> Gpu:
    """The GPU of a number, which the process shares. Raises `UnisimError`."""
    opened = opened_gpu(number)
    if isinstance(opened, UnisimError):
        raise opened
    return opened


def unusable(number: int = 0) -> str:
    """Return why a GPU traces no rays here, in a sentence; "" where it does."""
    if why := missing():
        return why
    opened = opened_gpu(number)
    return str(opened) if isinstance(opened, UnisimError) else ""


@functools.cache
def opened_gpu(number: int) -> Gpu | UnisimError:
    """The GPU of a number, or why it cannot be used: what failed, such as a compilation, is not tried again."""
    try:
        return Gpu(number)
    except UnisimError as error:
        return error


def rounded(size: int) -> int:
    """Return a number of bytes rounded up, by an eighth at most above some KB, so that sizes recur."""
    step = max(256, (1 << size.bit_length()) >> 4)
    return max(1, -(-size // step)) * step


class GpuMemory:
    """Memory on a GPU that is freed together: at the end of a `with`, or by `free`. With ``reuse`` it is given back to the
    GPU instead, whose later calls allocate nothing anew."""

    def __init__(self, gpu: Gpu, reuse: bool = False) -> None:
        self.gpu, self._reuse, self._addresses = gpu, reuse, list[tuple[int, int]]()
        self._staged: list[NDArray[Any]] = []
        weakref.finalize(self, _free, gpu, reuse, self._addresses).atexit = False

    def __enter__(self) -> GpuMemory:
        return self

    def __exit__(self, *_: object) -> None:
        self.free()

    def free(self) -> None:
        _free(self.gpu, self._reuse, self._addresses)
        self._staged.clear()

    def release(self) -> None:
        """Give memory back to what is launched later, after what uses it now; what was uploaded is staged until `free`."""
        _free(self.gpu, self._reuse, self._addresses)

    def allocate(self, size: int, clear: bool = False) -> int:
        """Return the address of so many new bytes; zeros where ``clear``. Raises `GpuMemoryError`."""
        whole = rounded(size) if self._reuse else max(size, 1)
        address = self.gpu.allocate(whole)
        self._addresses.append((address, whole))
        if clear and size:
            self.gpu.call("cuMemsetD8_v2", address, 0, size)
        return address

    def upload(self, values: NDArray[Any] | ctypes.Structure | ctypes.Array[Any]) -> int:
        """Return the address of a copy of an array, contiguous, or of a structure."""
        if isinstance(values, np.ndarray):
            assert values.flags.c_contiguous
            source, size = values.ctypes.data, values.nbytes
        else:
            source, size = ctypes.addressof(values), ctypes.sizeof(values)
        address = self.allocate(size)
        if size and self._reuse:
            # from pinned memory, which stays as it is until this is freed, the host need not wait for earlier launches
            staged = self.gpu.pinned((size,), np.uint8)
            ctypes.memmove(staged.ctypes.data, source, size)
            self._staged.append(staged)
            self.gpu.call("cuMemcpyHtoDAsync_v2", address, staged.ctypes.data, size, None)
        elif size:
            self.gpu.call("cuMemcpyHtoD_v2", address, source, size)
        return address

    def download(self, address: int, values: NDArray[Any]) -> None:
        """Copy memory on the GPU into an array."""
        assert values.flags.c_contiguous
        if values.nbytes:
            self.gpu.call("cuMemcpyDtoH_v2", values.ctypes.data, address, values.nbytes)


def _free(gpu: Gpu, reuse: bool, addresses: list[tuple[int, int]]) -> None:
    while addresses:
        address, size = addresses.pop()
        if reuse:
            gpu.give_back(address, size)
        else:
            gpu.free(address, size)
