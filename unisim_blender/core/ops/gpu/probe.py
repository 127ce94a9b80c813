"""The smallest kernel: it shows that Triton can compile and start one, for which it wants a C compiler too."""

from __future__ import annotations

import torch
import triton
import triton.language as tl


@triton.jit
def _increment(x, BLOCK: tl.constexpr):
    i = tl.arange(0, BLOCK)
    tl.store(x + i, tl.load(x + i) + 1)


def probe(device: torch.device | str) -> None:
    """Raises where Triton cannot compile a kernel, start it, or have it do what it says."""
    x = torch.zeros(16, device=device)
    with torch.cuda.device_of(x):
        _increment[(1,)](x, BLOCK=16)
    if not bool((x == 1).all()):
        raise RuntimeError(f"a kernel of Triton's left {x.tolist()}")
