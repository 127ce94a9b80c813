"""Operations and their implementations: what is there, what fits, and which one is chosen."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from unisim_blender.core import native, ops
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.ops import density, encode, field, near_spheres
from unisim_blender.core.ops.dispatch import Operation, on_cpu, on_cpu_or_gpu
from unisim_blender.core.ops.grid_shape import GridArrays, GridShape

ROOT = Path(ops.__file__).parent
MODULES = sorted(path.stem for path in ROOT.glob("*.py") if "\nOPERATION = " in path.read_text())


def operation(module: str) -> Operation[Any, Any]:
    own: Operation[Any, Any] = importlib.import_module(f"unisim_blender.core.ops.{module}").OPERATION
    return own


def test_the_operations_are_there() -> None:
    assert {
        "encode",
        "field",
        "mlp",
        "density",
        "propose",
        "quantiles",
        "transmittances",
        "gather",
        "near_spheres",
    } <= set(MODULES)


@pytest.mark.parametrize("module", MODULES)
def test_every_kernel_of_a_module_is_registered_on_its_device_and_takes_what_the_reference_takes(module: str) -> None:
    own = operation(module)
    launches = "gpu.launch(" in (ROOT / f"{module}.py").read_text()
    assert own.kernels == {"compiled": on_cpu_or_gpu if launches else on_cpu}
    reference = own.implementation("reference")
    name = reference.__name__.removesuffix("_reference")
    home = importlib.import_module(f"unisim_blender.core.ops.{module}")
    assert own.implementation("compiled") is getattr(home, f"{name}_compiled")
    assert inspect.signature(own.implementation("compiled")) == inspect.signature(reference)
    assert inspect.signature(getattr(home, name)) == inspect.signature(reference)


@pytest.mark.parametrize("kind", [torch.float32, torch.float64, torch.float16])
def test_tensors_on_the_cpu(kind: torch.dtype) -> None:
    s = torch.zeros(2, 3, dtype=kind)
    compiled = kind == torch.float32 and native.library() is not None
    assert density.OPERATION.chosen(s, 1.0) == ("compiled" if compiled else "reference")


def test_a_gpus_kernels_take_its_tensors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("unisim_blender.core.ops.gpu.serves", lambda like: True)
    monkeypatch.setattr(native, "library", lambda: None)
    grid = GridArrays(GridShape.unit(2, 4, 2, 2, 8))
    table, x = torch.zeros(grid.rows, 2), torch.zeros(1, 3)
    assert encode.OPERATION.chosen(grid, table, x) == "compiled"
    assert encode.OPERATION.chosen(grid, table.double(), x) == "reference", "all of the tensors decide"


def test_a_field_that_learns_has_its_operations_one_by_one() -> None:
    grid = GridArrays(GridShape.unit(2, 4, 2, 2, 8))
    x, w1, w2, bias = torch.zeros(1, 3), torch.zeros(3, grid.shape.width), torch.zeros(2, 3), torch.zeros(2)
    table = torch.zeros(grid.rows, 2, requires_grad=True)
    alone = "reference" if native.library() is None else "compiled"
    assert field.OPERATION.chosen(grid, table, x, w1, w2, bias) == "reference"
    assert field.OPERATION.chosen(grid, table.detach(), x, w1, w2, bias) == alone
    with torch.no_grad():
        assert field.OPERATION.chosen(grid, table, x, w1, w2, bias) == alone


def test_an_implementation_from_outside_comes_first_where_it_applies(monkeypatch: pytest.MonkeyPatch) -> None:
    own = near_spheres.OPERATION
    monkeypatch.setattr(own, "kernels", own.kernels)
    seen: list[int] = []

    def few(tensors: Sequence[Tensor]) -> bool:
        return len(tensors[0]) < 3

    def mine(origins: Tensor, directions: Tensor, bins: Tensor, centres: Tensor, radii: Tensor) -> Tensor:
        seen.append(len(origins))
        return own.implementation("reference")(origins, directions, bins, centres, radii)

    own.register("mine", few, mine)
    for count in (2, 5):
        trajectory = torch.tensor([[1.0, 0, 0]]).expand(count, 3)
        arguments = (
            torch.zeros(count, 3),
            trajectory,
            torch.zeros(count, dtype=torch.long),
            torch.ones(1, 1, 3),
            torch.ones(1, 1),
        )
        near = near_spheres.near_spheres(*arguments)
        assert torch.equal(near, own.implementation("reference")(*arguments))
    assert seen == [2]


@pytest.mark.skipif(native.library() is None, reason="the compiled kernels are not built")
def test_kernels_of_other_sources_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plain torch in their place would train ten times slower, and nobody would notice."""
    monkeypatch.setattr(native, "ABI_VERSION", native.ABI_VERSION + 1)
    monkeypatch.delenv("UNISIM_NATIVE", raising=False)
    with pytest.raises(UnisimError, match=r"_unisim_native.* was built from other sources .*: run make setup"):
        native.library.__wrapped__()
