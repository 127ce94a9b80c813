"""The names that stay: what they are, what importing them costs, and that the page of Python needs no others."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

from unisim_blender import api

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "python.md"


def test_importing_the_names_imports_nothing_else() -> None:
    code = "import sys, unisim_blender.api; print(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    packages = ("unisim_blender", "numpy", "torch")
    assert {name for name in out.split() if name.startswith(packages)} == {"unisim_blender", "unisim_blender.api"}


def test_no_name_imports_torch() -> None:
    code = f"import sys; from unisim_blender.api import {', '.join(dir(api))}; print('torch' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "False"


@pytest.mark.parametrize("name", dir(api))
def test_every_name_is_there_and_on_the_page(name: str) -> None:
    assert getattr(api, name) is not None
    assert re.search(rf"`{name}\b", PAGE.read_text(encoding="utf-8"))


def test_another_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'plan_scenario'"):
        _ = api.plan_scenario


def test_the_page_imports_nothing_of_the_package_but_these_names() -> None:
    page = PAGE.read_text(encoding="utf-8")
    trees = [ast.parse(block) for block in re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)]
    imports = [node for tree in trees for node in ast.walk(tree) if isinstance(node, (ast.Import, ast.ImportFrom))]
    modules = {name for node in imports for name in _modules(node) if name.startswith("unisim")}
    assert modules == {"unisim_blender.api"}


def _modules(node: ast.Import | ast.ImportFrom) -> list[str]:
    return [node.module or ""] if isinstance(node, ast.ImportFrom) else [alias.name for alias in node.names]


def test_a_frame_needs_a_number_or_a_time() -> None:
    with pytest.raises(ValueError, match="give a frame or a time"):
        api._microseconds(None)
