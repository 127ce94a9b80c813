"""Choose which implementation of an operation works on given tensors.

An operation is a module: its function for everybody, the same in plain torch, and by the compiled kernels. Triton's
kernels are in `gpu`, a module for each operation that has some, imported when it is first chosen.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import os
import warnings
from collections.abc import Callable, Sequence
from typing import Generic, ParamSpec, TypeVar, cast

import torch
from torch import Tensor

from .. import native

P = ParamSpec("P")
R = TypeVar("R")

REFERENCE = "reference"
Takes = Callable[[Sequence[Tensor]], bool]
"""Function that returns whether an implementation takes tensors of one device."""


def on_cpu(tensors: Sequence[Tensor]) -> bool:
    """Return whether the compiled kernels take tensors: float32 on the CPU, where the library was built."""
    return _are_float32(tensors) and tensors[0].device.type == "cpu" and native.library() is not None


def on_gpu(tensors: Sequence[Tensor]) -> bool:
    """Return whether Triton's kernels take tensors: float32 on a GPU, where a first kernel ran."""
    return _are_float32(tensors) and triton_ready(tensors[0])


def _are_float32(tensors: Sequence[Tensor]) -> bool:
    return all(tensor.dtype == torch.float32 for tensor in tensors)


def triton_ready(like: Tensor) -> bool:
    """Return whether Triton is installed and runs on the GPU of a tensor; False with UNISIM_TRITON=0."""
    return like.is_cuda and _triton_runs_on(str(like.device))


@functools.cache
def _triton_runs_on(device: str) -> bool:
    if os.environ.get("UNISIM_TRITON", "1") == "0" or importlib.util.find_spec("triton") is None:
        return False
    try:
        from .gpu.probe import probe

        probe(device)
    except Exception as error:  # noqa: BLE001 whatever a compiler or a driver raises: torch's operations do as well
        why = (str(error).splitlines() or [type(error).__name__])[0]
        warnings.warn(f"Triton's kernels do not run on {device}, torch's own operations are used: {why}", stacklevel=2)
        return False
    return True


class Operation(Generic[P, R]):
    """An operation and its implementations, in order of preference: Triton's, the compiled one, the reference.

    ``reference`` is its function in plain torch, ``compiled`` that of the compiled kernels, ``gpu`` the name of
    Triton's, "module.function" in `ops.gpu`; all have the same parameters. ``tensors`` returns, of the arguments of a
    call, those whose type and device decide; none where only the reference serves.
    """

    def __init__(
        self,
        reference: Callable[P, R],
        tensors: Callable[P, Sequence[Tensor]],
        compiled: Callable[P, R],
        gpu: str | None = None,
    ) -> None:
        self.kernels: dict[str, Takes] = {"compiled": on_cpu} if gpu is None else {"gpu": on_gpu, "compiled": on_cpu}
        self._tensors, self._gpu = tensors, gpu
        self._functions: dict[str, Callable[P, R]] = {REFERENCE: reference, "compiled": compiled}

    def register(self, name: str, takes: Takes, function: Callable[P, R]) -> None:
        """Put an implementation from outside of the package before all others."""
        self.kernels = {name: takes, **self.kernels}
        self._functions[name] = function

    def chosen(self, *args: P.args, **kwargs: P.kwargs) -> str:
        """Return the name of the implementation that carries out a call with these arguments."""
        tensors = self._tensors(*args, **kwargs)
        if tensors:
            for name, takes in self.kernels.items():
                if takes(tensors):
                    return name
        return REFERENCE

    def implementation(self, name: str) -> Callable[P, R]:
        """Return an implementation's function; Triton's is imported when it is first asked for."""
        if name == "gpu" and name not in self._functions and self._gpu is not None:
            module, _, function = self._gpu.rpartition(".")
            kernels = importlib.import_module(f"{__package__}.gpu.{module}")
            self._functions[name] = cast(Callable[P, R], getattr(kernels, function))
        return self._functions[name]

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Carry the operation out, by the first implementation that takes the tensors."""
        return self.implementation(self.chosen(*args, **kwargs))(*args, **kwargs)
