"""Parallel branches of a training step's loss: their graphs share only leaves, so each goes forward and backward
in its own thread."""

from __future__ import annotations

import contextvars
import threading
from collections.abc import Callable, Sequence
from typing import TypeVar

import torch
from torch import Tensor

from ...ops.encode import as_branch

T = TypeVar("T")


def run_branches(branches: Sequence[Callable[[], T]], together: bool) -> list[T]:
    """Return each branch's result; ``together`` runs them at once, else one comes after the other.

    A branch may wait for what one before it leaves, none for one behind it. Of errors the first branch's is raised,
    when all have ended.
    """
    threads = torch.get_num_threads()
    results: list[T | BaseException | None] = [None] * len(branches)

    def work(number: int) -> None:
        try:
            # of its own accord a new thread takes all cores in some of torch's libraries
            torch.set_num_threads(threads)
            with as_branch(number):
                results[number] = branches[number]()
        except BaseException as error:  # noqa: BLE001
            results[number] = error

    others = []
    for number in range(1, len(branches) if together else 1):
        thread = threading.Thread(target=contextvars.copy_context().run, args=(work, number))
        thread.start()
        others.append(thread)
    for number in range(1 if together else len(branches)):
        work(number)
    for thread in others:
        thread.join()
    out: list[T] = []
    for result in results:
        if isinstance(result, BaseException):
            raise result
        out.append(result)  # type: ignore[arg-type]
    return out


class BranchGradients:
    """What a branch's terms make of the gradients of some leaves; nobody else sees it until it is added to theirs."""

    def __init__(self, leaves: Sequence[Tensor]) -> None:
        self.leaves = leaves
        self._own: list[Tensor | None] = [None] * len(leaves)

    def take(self, loss: Tensor) -> None:
        """Go backward from a loss, whose graph is then gone."""
        if not loss.requires_grad:
            return
        parts = torch.autograd.grad(loss, self.leaves, allow_unused=True)
        pairs = zip(self._own, parts, strict=True)
        self._own = [new if old is None else old if new is None else old + new for old, new in pairs]

    def add(self) -> None:
        """Add them to the leaves' own."""
        for leaf, gradient in zip(self.leaves, self._own, strict=True):
            if gradient is None:
                continue
            if leaf.grad is None:
                leaf.grad = gradient.clone(memory_format=torch.preserve_format)
            else:
                leaf.grad.add_(gradient)
