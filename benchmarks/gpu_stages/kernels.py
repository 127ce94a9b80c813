"""The kernels of training beside torch: values and gradients, held against torch's in float64.

A kernel may be off by `BOUND` of the largest value, or by twice what torch's own float32 is off: where places are
multiplied by thousands of cells, float32 itself is not better. What is not a number is never within a bound.
"""

from __future__ import annotations

import re
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor

from unisim_blender.core.ops import gpu

from .machine import CORE
from .settings import Findings, Settings

BOUND = 2e-5
APART = 0.01
"""Share of rays or places that may be apart where rounding chooses between two voxels."""
READY = "unisim_blender.core.ops.gpu.serves"


def held_against(got: Tensor, want: Tensor, plain: Tensor) -> dict[str, Any]:
    """Return a kernel's errors beside torch in float64, their bound, and whether they pass; ``plain`` is
    torch's in float32."""
    scale = float(want.abs().max().clamp_min(1e-3))
    worst = float((got.double() - want).abs().max())
    own = float((plain.double() - want).abs().max()) / scale
    bound = max(BOUND, 2 * own)
    spread = float(torch.linalg.vector_norm(got.double() - want) / torch.linalg.vector_norm(want).clamp_min(1e-30))
    return {
        "max_abs": worst, "max_rel": worst / scale, "l2_rel": spread, "torch_float32_max_rel": own, "bound": bound,
        "pass": got.shape == want.shape and worst / scale <= bound,
    }  # fmt: skip


def apart(got: Tensor, want: Tensor, near: float) -> dict[str, Any]:
    """Return which share of numbers is further apart than ``near``, its bound, and whether it is within that."""
    difference = (got - want).abs()
    share = 1 - float((difference <= near).float().mean())
    return {
        "max_abs": float(difference.max()), "median_abs": float(difference.median()), "share_apart": share,
        "near": near,
        "bound": APART, "pass": share <= APART and bool(torch.isfinite(got).all()),
    }  # fmt: skip


def kernel_names() -> set[str]:
    """Return the kernels that operations launch."""
    sources = [file.read_text(encoding="utf-8") for file in sorted((CORE / "ops").glob("*.py"))]
    return {name for source in sources for name in re.findall(r'gpu\.launch\("(\w+)"', source)}


@contextmanager
def noted_launches() -> Iterator[set[str]]:
    """Give the set that names, meanwhile, each kernel that is launched."""
    launched: set[str] = set()
    launch = gpu.launch

    def noted(kernel: str, *arguments: Any) -> None:
        launched.add(kernel)
        launch(kernel, *arguments)

    with patch.object(gpu, "launch", noted):
        yield launched


def compare_kernels(settings: Settings, found: Findings) -> None:
    """Note each kernel's errors; raise where one is out of its bound or was not launched."""
    if not gpu.serves(torch.zeros(1, device=settings.device)):
        found.note(skipped=f"no kernels for GPUs run on {settings.device}")
        return
    from .cases import cases

    every = kernel_names()
    errors: dict[str, Any] = {}
    with noted_launches() as launched:
        for name, compare in cases(settings.device, settings.samples):
            try:
                if found.left_s() < 5:
                    raise TimeoutError("there was no time left")
                errors[name] = compare()
            except Exception:  # noqa: BLE001 the other kernels are worth their time all the same
                found.failed(name, traceback.format_exc())
            wrong = [
                f"{case}: {what}" for case, of in errors.items() for what, error in of.items() if not error["pass"]
            ]
            found.note(cases=errors, wrong=wrong, launched=sorted(launched), not_launched=sorted(every - launched))
    if found.values["wrong"] or found.values["not_launched"]:
        raise ValueError(f"out of bound: {found.values['wrong']}; never launched: {found.values['not_launched']}")
