"""Triton's kernels beside torch: values and gradients, held against torch's in float64.

A kernel may be off by `BOUND` of the largest value, or by twice what torch's own float32 is off: where places are
multiplied by thousands of cells, float32 itself is not better. What is not a number is never within a bound.
"""

from __future__ import annotations

import ast
import importlib
import os
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor

from .machine import CORE
from .settings import Findings, Settings

BOUND = 2e-5
APART = 0.01
"""Share of rays or places that may be apart where rounding chooses between two voxels."""
READY = "unisim_blender.core.ops.dispatch.triton_ready"


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
    """Return the kernels that are launched, as module.function of `core.ops`: functions of `triton.jit`
    that no other calls."""
    jitted: dict[str, ast.FunctionDef] = {}
    helpers: set[str] = set()
    for file in sorted((CORE / "ops").rglob("*.py")):
        module = ".".join(file.relative_to(CORE / "ops").with_suffix("").parts)
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and any("triton.jit" in ast.unparse(d) for d in node.decorator_list):
                jitted[f"{module}.{node.name}"] = node
                calls = [call.func for call in ast.walk(node) if isinstance(call, ast.Call)]
                # helpers that another module calls are imported by the same name
                helpers |= {function.id for function in calls if isinstance(function, ast.Name)}
    return {name for name, node in jitted.items() if node.name not in helpers}


class _Noted:
    """A kernel that notes its launches."""

    def __init__(self, kernel: Any, name: str, launched: set[str]) -> None:
        self.kernel, self.name, self.launched = kernel, name, launched

    def __getitem__(self, grid: Any) -> Any:
        self.launched.add(self.name)
        return self.kernel[grid]


@contextmanager
def noted_launches() -> Iterator[set[str]]:
    """Give the set that names, meanwhile, each kernel that is launched."""
    launched: set[str] = set()
    patches = []
    for name in kernel_names():
        path, _, function = name.rpartition(".")
        module = importlib.import_module(f"unisim_blender.core.ops.{path}")
        patches.append(patch.object(module, function, _Noted(getattr(module, function), name, launched)))
    for each in patches:
        each.start()
    try:
        yield launched
    finally:
        for each in patches:
            each.stop()


def runnable(device: str) -> bool:
    """Whether Triton's kernels can take a device's tensors: a GPU's, or the CPU's by Triton's interpreter."""
    return device != "cpu" or os.environ.get("TRITON_INTERPRET") == "1"


@contextmanager
def interpreter_mended() -> Iterator[None]:
    """Let Triton's interpreter count loops meanwhile where numpy makes no number of an array of one:
    Triton 3.6, numpy 2.5."""
    if os.environ.get("TRITON_INTERPRET") != "1":
        yield
        return
    from triton.runtime import interpreter

    prepare = interpreter._patch_lang_tensor

    def prepared(tensor: Any, *scope: Any) -> None:
        prepare(tensor, *scope)
        tensor.__index__ = lambda self: int(self.handle.data.item())

    with patch.object(interpreter, "_patch_lang_tensor", prepared):
        yield


def compare_kernels(settings: Settings, found: Findings) -> None:
    """Note each kernel's errors; raise where one is out of its bound or was not launched."""
    if not runnable(settings.device):
        found.note(skipped="no GPU, and TRITON_INTERPRET is not 1")
        return
    from .cases import cases

    every = kernel_names()
    errors: dict[str, Any] = {}
    with patch(READY, lambda like: True), interpreter_mended(), noted_launches() as launched:
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
