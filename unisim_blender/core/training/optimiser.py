"""Adam as torch has it, without torch's compiler: torch's optimisers import it, which takes seconds, to keep out of it."""

from __future__ import annotations

import inspect
from typing import Any

import torch


def _plain(name: str) -> Any:
    """A method of torch's Adam as it is written, out of what decorates it."""
    return inspect.unwrap(getattr(torch.optim.Adam, name))


class Adam(torch.optim.Adam):
    """Takes the steps of `torch.optim.Adam`, to the bit. It cannot be part of what torch compiles."""

    _step, _add, _zero = _plain("step"), _plain("add_param_group"), _plain("zero_grad")
    _state, _load = _plain("state_dict"), _plain("load_state_dict")

    def add_param_group(self, param_group: dict[str, Any]) -> None:
        """See torch."""
        self._add(param_group)

    def zero_grad(self, set_to_none: bool = True) -> None:
        """See torch."""
        self._zero(set_to_none)

    def state_dict(self) -> dict[str, Any]:
        """See torch."""
        return dict(self._state())

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """See torch."""
        self._load(state_dict)

    @torch.no_grad()
    def step(self, closure: Any = None) -> Any:
        """See torch."""
        return self._step(closure)
