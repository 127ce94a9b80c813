"""Choose which implementation of an operation works on given tensors.

An operation is a package. Its ``reference.py`` says in plain torch what it gives. Other modules of the package have
kernels: each has a function of the reference's name and parameters, and is imported when it is first chosen.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from typing import Generic, ParamSpec, TypeVar, cast

import torch
from torch import Tensor

from .. import native
from .triton_ready import ready

P = ParamSpec("P")
R = TypeVar("R")

REFERENCE = "reference"
Takes = Callable[[Sequence[Tensor]], bool]
"""Whether kernels take tensors that lie on one device."""


def on_cpu(tensors: Sequence[Tensor]) -> bool:
    """Whether the compiled kernels take tensors: float32's on the CPU, where the library was built."""
    return _are_float32(tensors) and tensors[0].device.type == "cpu" and native.library() is not None


def on_gpu(tensors: Sequence[Tensor]) -> bool:
    """Whether Triton's kernels take tensors: float32's on a GPU, where a first kernel ran."""
    return _are_float32(tensors) and ready(tensors[0])


def _are_float32(tensors: Sequence[Tensor]) -> bool:
    return all(tensor.dtype == torch.float32 for tensor in tensors)


class Operation(Generic[P, R]):
    """An operation and its implementations.

    ``reference`` is its function in plain torch. ``tensors`` gives, of the arguments of a call, those whose type and
    device decide; none where only the reference serves. ``kernels`` has the other modules by name, in order of
    preference, each with the predicate that says which tensors it takes.
    """

    def __init__(
        self, reference: Callable[P, R], tensors: Callable[P, Sequence[Tensor]], kernels: Mapping[str, Takes]
    ) -> None:
        self.package, _, module = reference.__module__.rpartition(".")
        assert module == REFERENCE, reference.__module__
        self.name, self.kernels = reference.__name__, dict(kernels)
        self._tensors = tensors
        self._functions: dict[str, Callable[P, R]] = {REFERENCE: reference}

    def register(self, name: str, takes: Takes, function: Callable[P, R]) -> None:
        """Put an implementation from outside of the package before all others."""
        self.kernels = {name: takes, **self.kernels}
        self._functions[name] = function

    def chosen(self, *args: P.args, **kwargs: P.kwargs) -> str:
        """Name of the implementation that carries out a call with these arguments."""
        tensors = self._tensors(*args, **kwargs)
        if tensors:
            for name, takes in self.kernels.items():
                if takes(tensors):
                    return name
        return REFERENCE

    def implementation(self, name: str) -> Callable[P, R]:
        """An implementation's function, imported where it was not yet."""
        if name not in self._functions:
            found = getattr(importlib.import_module(f"{self.package}.{name}"), self.name)
            self._functions[name] = cast(Callable[P, R], found)
        return self._functions[name]

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Carry the operation out, by the first implementation that takes the tensors."""
        return self.implementation(self.chosen(*args, **kwargs))(*args, **kwargs)
