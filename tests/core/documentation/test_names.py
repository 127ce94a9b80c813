"""Names of classes: each is defined once, so that a search by name finds one definition."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = ("unisim_blender", "unisim_bench", "unisim_street")
VARIABLES = {"TypeVar", "ParamSpec"}


def public_names(source: str) -> Iterator[str]:
    """Yield the public classes and aliases of types that a module defines; type variables are none."""
    for node in ast.parse(source).body:
        match node:
            case ast.ClassDef(name=name):
                pass
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id in VARIABLES:
                    continue
            case ast.AnnAssign(target=ast.Name(id=name), annotation=ast.Name(id="TypeAlias")):
                pass
            case _:
                continue
        if name[0].isupper() and not name.isupper():
            yield name


def repeated(sources: dict[str, str]) -> dict[str, list[str]]:
    """Return the names that several modules define, and these modules."""
    places: dict[str, list[str]] = defaultdict(list)
    for path, source in sources.items():
        for name in public_names(source):
            places[name].append(path)
    return {name: paths for name, paths in places.items() if len(paths) > 1}


def test_every_public_class_and_alias_is_defined_once() -> None:
    modules = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    assert len(modules) > 500, "all packages are read"
    assert repeated({str(path.relative_to(ROOT)): path.read_text("utf-8") for path in modules}) == {}


@pytest.mark.parametrize(
    "a, b, names",
    [
        ("class Part: ...", "Part = tuple[int, str]", {"Part"}),
        ("class Part: ...", "from .a import Part", set()),
        ("class _Part: ...", "class _Part: ...", set()),
        ("T = TypeVar('T')\nResultT = TypeVar('ResultT')", "ResultT = TypeVar('ResultT')", set()),
        ("LIMIT = 1\nclass View(Protocol): ...", "LIMIT = 2\nView: TypeAlias = 'int'", {"View"}),
    ],
    ids=["class and alias", "import", "private", "type variables", "annotated alias"],
)
def test_what_counts_as_defined_twice(a: str, b: str, names: set[str]) -> None:
    assert set(repeated({"a.py": a, "b.py": b})) == names
