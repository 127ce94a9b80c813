"""Operations that a host would wait for, or that a GPU's graph of operations cannot hold, refused."""

from __future__ import annotations

from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten

REFUSED = {
    "aten::_local_scalar_dense",
    "aten::item",
    "aten::is_nonzero",
    "aten::equal",
    "aten::nonzero",
    "aten::argwhere",
    "aten::masked_select",
    "aten::_unique",
    "aten::_unique2",
    "aten::unique_dim",
    "aten::unique_consecutive",
    "aten::bincount",
    "aten::lift_fresh",
}
"""Values that Python reads, shapes that depend on values, and tensors made of Python's numbers, which are copied over."""
INDEXED = {"aten::index", "aten::index_put", "aten::index_put_", "aten::_index_put_impl_"}


class HostDecision(RuntimeError):
    """An operation that waits for the device."""


def refuse(func: Any, args: Any, kwargs: Any) -> None:
    """Raise `HostDecision` for an operation that would wait."""
    name = func._schema.name
    tensors = [x for x in tree_flatten((args, kwargs))[0] if isinstance(x, torch.Tensor)]
    masks = name in INDEXED and any(i is not None and i.dtype in (torch.bool, torch.uint8) for i in args[1])
    counted = (
        name == "aten::repeat_interleave" and func._overloadname != "self_int" and kwargs.get("output_size") is None
    )
    moved = name in ("aten::_to_copy", "aten::copy_") and len({x.device for x in tensors}) > 1
    if name == "aten::_to_copy" and kwargs.get("device") is not None:
        moved = torch.device(kwargs["device"]).type != tensors[0].device.type
    if name in REFUSED or masks or counted or moved:
        raise HostDecision(f"{name} waits for the device, of shapes {[tuple(x.shape) for x in tensors]}")


class NoHostDecisions(TorchDispatchMode):
    """Inside, operations that would wait raise."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        refuse(func, args, kwargs or {})
        return func(*args, **(kwargs or {}))
