"""A GPU that is none: tensors that say they are on one while the CPU works, and that refuse what a GPU would refuse.

An operation on tensors of two devices raises, as does asking one of the pretended device for its numpy array. Values
are the CPU's own. So what runs here runs on a GPU, as far as it is a matter of where tensors are.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import torch
from torch.optim import optimizer
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map

DEVICE = torch.device("meta")
"""A name that torch knows, and for which it asks no driver."""
TRANSFERS = {"aten::_to_copy", "aten::copy_", "aten::to", "aten::_local_scalar_dense"}
"""May have tensors of two devices."""


class Pretended(torch.Tensor):
    """``own`` is where its numbers are."""

    own: torch.Tensor

    @staticmethod
    def __new__(cls, real: torch.Tensor) -> Pretended:
        out: Pretended = torch.Tensor._make_wrapper_subclass(
            cls,
            real.shape,
            strides=real.stride(),
            storage_offset=real.storage_offset(),
            dtype=real.dtype,
            device=DEVICE,
        )
        out.own = real
        return out

    def __repr__(self) -> str:  # type: ignore[override]
        return f"Pretended({self.own})"

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:  # type: ignore[override]
        return on_pretended(func, args, kwargs or {})


def on_pretended(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    """An operation, by the CPU, and its results where they belong."""
    name = func._schema.name
    given = [x for x in tree_flatten((args, kwargs))[0] if isinstance(x, torch.Tensor)]
    pretended = [x for x in given if isinstance(x, Pretended)]
    # a number in a tensor may be the CPU's
    others = [x for x in given if not isinstance(x, Pretended) and x.dim() > 0]
    indexed = name in ("aten::index", "aten::index_put", "aten::index_put_", "aten::_index_put_impl_")
    if pretended and others and name not in TRANSFERS and not (indexed and isinstance(args[0], Pretended)):
        shapes = [[tuple(x.shape) for x in some] for some in (pretended, others)]
        raise RuntimeError(f"{name} got tensors of two devices, of shapes {shapes[0]} and {shapes[1]}")
    device = kwargs.get("device")
    goes_there = bool(pretended) if device is None else torch.device(device).type == DEVICE.type
    if name == "aten::copy_":
        goes_there = isinstance(args[0], Pretended)
    if device is not None:
        kwargs = {**kwargs, "device": torch.device("cpu")}
    back = {id(x.own): x for x in pretended}
    args, kwargs = tree_map(lambda x: x.own if isinstance(x, Pretended) else x, (args, kwargs))
    out = func(*args, **kwargs)

    def place(x: Any) -> Any:
        if not isinstance(x, torch.Tensor) or not goes_there:
            return x
        # what an operation changed in place is what it was given
        return back.get(id(x)) if id(x) in back else Pretended(x)

    if name == "aten::_local_scalar_dense":
        return out
    return tree_map(place, out)


class _Mode(TorchDispatchMode):
    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return on_pretended(func, args, kwargs or {})


class _Makers(TorchFunctionMode):
    """What makes tensors of values goes to a device by a way of its own."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if func in (torch.tensor, torch.as_tensor) and kwargs.get("device") is not None:
            device = torch.device(kwargs.pop("device"))
            return func(*args, **kwargs).to(device)
        if func is torch.Tensor.new_tensor:
            return torch.tensor(args[1], **{"dtype": args[0].dtype, **kwargs}).to(args[0].device)
        return func(*args, **kwargs)


class _Generator(torch.Generator):
    """The CPU's, whatever was asked for."""

    def __new__(cls, device: Any = None) -> _Generator:
        return super().__new__(cls)


@contextmanager
def pretended_gpu(patch: pytest.MonkeyPatch) -> Iterator[torch.device]:
    """Inside, this device is there."""
    supported = optimizer._get_fused_kernels_supported_devices  # type: ignore[attr-defined]
    patch.setattr(optimizer, "_get_fused_kernels_supported_devices", lambda: [*supported(), DEVICE.type])
    patch.setattr(torch, "Generator", _Generator)
    with _Makers(), _Mode():  # type: ignore[no-untyped-call]
        yield DEVICE
