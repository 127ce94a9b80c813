"""Choose which implementation of an operation works on given tensors.

An operation is a module: its function for everybody, the same in plain torch, and by the compiled kernels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic, ParamSpec, TypeVar

import torch
from torch import Tensor

from .. import native
from . import gpu

P = ParamSpec("P")
R = TypeVar("R")

REFERENCE = "reference"
Takes = Callable[[Sequence[Tensor]], bool]
"""Function that returns whether an implementation takes tensors of one device."""


def on_cpu(tensors: Sequence[Tensor]) -> bool:
    """Return whether the compiled kernels take tensors: float32 on the CPU, where the library was built."""
    return _are_float32(tensors) and tensors[0].device.type == "cpu" and native.library() is not None


def on_cpu_or_gpu(tensors: Sequence[Tensor]) -> bool:
    """Return whether the compiled kernels take tensors: float32 on the CPU, or on a GPU that they run on."""
    return on_cpu(tensors) or (_are_float32(tensors) and gpu.serves(tensors[0]))


def _are_float32(tensors: Sequence[Tensor]) -> bool:
    return all(tensor.dtype == torch.float32 for tensor in tensors)


class Operation(Generic[P, R]):
    """An operation and its implementations, in order of preference: the compiled one, the reference.

    ``reference`` is its function in plain torch, ``compiled`` that of the compiled kernels; both have the same
    parameters. ``tensors`` returns, of the arguments of a call, those whose type and device decide; none where only the
    reference serves. ``takes`` says whether the compiled kernels take these.
    """

    def __init__(
        self,
        reference: Callable[P, R],
        tensors: Callable[P, Sequence[Tensor]],
        compiled: Callable[P, R],
        takes: Takes = on_cpu,
    ) -> None:
        self.kernels: dict[str, Takes] = {"compiled": takes}
        self._tensors = tensors
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
        """Return an implementation's function."""
        return self._functions[name]

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Carry the operation out, by the first implementation that takes the tensors."""
        return self.implementation(self.chosen(*args, **kwargs))(*args, **kwargs)
