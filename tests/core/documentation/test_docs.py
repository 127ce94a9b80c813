"""The documentation's form: links and paths lead somewhere, every option has its line, quoted code is the code, prose
can be read in a terminal."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import pytest
import tomllib
from documentation_pages import NAMES, PAGES, ROOT, anchors, blocks, links, paragraphs, prose

from unisim_blender.core.cli.main import unisim
from unisim_blender.core.render.renderer import Renderer

LONGEST_LINE = 120
MOST_LINES = 4
"""Of a paragraph, or of an item of a list."""
LANGUAGES = {"sh", "python", "json", "text"}
SOURCES = (".py", ".h", ".cpp")
ROOTS = (ROOT, ROOT / "native", ROOT / "unisim_blender", ROOT / "unisim_blender" / "core")
"""Where paths on the pages begin."""
TO_BE_ADDED = {
    "core/scenario/edits/relabel.py",
    "editing/readers/relabel.py",
    "bridge/changes/carriers/label.py",
}
"""Files that the manual tells readers to add."""
QUOTED: dict[str, Callable[..., Any]] = {"Renderer.render": Renderer.render}
"""Functions that the pages show."""


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target in links(text):
        if target.startswith(("http://", "https://")):
            continue
        path, _, anchor = target.partition("#")
        there = page if not path else (page.parent / path).resolve()
        assert there.exists(), f"{page.name}: {target}"
        if anchor:
            assert anchor in anchors(there.read_text(encoding="utf-8")), f"{page.name}: {target}"


def test_every_page_is_in_the_website_and_every_image_in_a_page() -> None:
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    pages = [page.relative_to(ROOT / "docs").as_posix() for page in PAGES if page.is_relative_to(ROOT / "docs")]
    assert [page for page in pages if page not in navigation] == []
    shown = {Path(target).name for page in PAGES for target in links(page.read_text(encoding="utf-8"))}
    images = {path.name for path in (ROOT / "docs" / "images").rglob("*") if path.is_file()}
    assert images - shown == set()


def found(path: str, folders: set[Path]) -> list[Path]:
    """Return what a path on a page may mean, below folders. A part of it in capitals stands for any name."""
    pattern = "/".join("*" if part.isupper() else part for part in path.split("/"))
    return [there for folder in sorted(folders) for there in folder.glob(pattern)]


def missing_paths(text: str) -> list[str]:
    """Return the quoted paths of sources that lie neither below a root nor in a folder that the page names."""
    quoted = re.findall(r"`([\w.-][\w./-]*)`", text)
    folders = set(ROOTS)
    for _ in range(2):  # folders may be named from folders
        here = [there for path in quoted if path.endswith(("/", *SOURCES)) for there in found(path, folders)]
        folders |= {there if there.is_dir() else there.parent for there in here}
    return [path for path in quoted if path.endswith(SOURCES) and not found(path, folders)]


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_paths_of_sources_lead_somewhere(page: Path) -> None:
    assert set(missing_paths(page.read_text(encoding="utf-8"))) <= TO_BE_ADDED
    assert [path for path in TO_BE_ADDED if found(path, set(ROOTS))] == []


def test_paths_in_comments_of_kernels_lead_somewhere() -> None:
    for source in (ROOT / "native").rglob("*.*"):
        named = re.findall(r"[\w/]+\.py\b", source.read_text(encoding="utf-8"))
        assert [path for path in named if not found(path, set(ROOTS))] == [], source.name


def test_a_path_that_leads_nowhere_is_found() -> None:
    assert missing_paths("`model/decode.py`, `lattice/blocks.py`, `quantiles.py`") == [
        "lattice/blocks.py",
        "quantiles.py",
    ]
    assert missing_paths("`render/tracers/`, `warping.py`, `ops/encode.py`, `trace/light.h`") == []


def test_quoted_functions_are_the_code() -> None:
    page = (ROOT / "docs" / "explanation" / "design.md").read_text(encoding="utf-8")
    shown = {block.reason.removeprefix("a copy of "): block.text for block in blocks(page) if block.reason}
    assert shown == {name: textwrap.dedent(inspect.getsource(function)) for name, function in QUOTED.items()}


@pytest.mark.parametrize(
    ("label", "contract"), [("Core", "rooms point one way"), ("Blender's side", "Blender's side points one way")]
)
def test_the_order_of_imports_is_that_of_the_contracts(label: str, contract: str) -> None:
    page = " ".join((ROOT / "docs" / "explanation" / "design.md").read_text(encoding="utf-8").split())
    (shown,) = re.findall(rf"\*\*{label}\*\*, from top to bottom: (.*?)\.", page)
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    (layers,) = (each["layers"] for each in contracts if each["name"] == contract)
    assert shown.replace("`", "").split("; ") == [layer.replace(" | ", ", ") for layer in layers]


def test_every_room_of_core_is_in_the_table() -> None:
    page = (ROOT / "docs" / "explanation" / "design.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`.*?) \|", page, re.M)
    shown = {name.split("/")[0] for row in rows for name in re.findall(r"`([\w./]+)`", row)}
    rooms = {path.parent.name for path in (ROOT / "unisim_blender" / "core").glob("*/__init__.py")}
    assert rooms - shown == set()


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_lines_and_paragraphs_are_short_and_blocks_have_a_language(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    long = [f"{page.name}:{number}" for number, line in prose(text) if len(line) >= LONGEST_LINE]
    long += [f"{page.name}:{first}: {count} lines" for first, count in paragraphs(text) if count > MOST_LINES]
    assert long == []
    # a ">" that was wrapped to a line's begin would make a quotation
    before = {number: line for number, line in enumerate(text.splitlines(), 2)}
    assert [n for n, line in prose(text) if line.startswith(">") and before[n].strip() and before[n][0] != ">"] == []
    assert [(block.line, block.language) for block in blocks(text) if block.language not in LANGUAGES] == []


def test_the_command_line_page_has_every_command_and_help_every_option() -> None:
    page = (ROOT / "docs" / "reference" / "command-line.md").read_text(encoding="utf-8")
    context = click.Context(unisim)
    assert sorted(re.findall(r"^## (\w+)$", page, re.M)) == sorted(unisim.list_commands(context))
    for name in unisim.list_commands(context):
        command = unisim.get_command(context, name)
        assert command is not None
        options = [parameter for parameter in command.params if isinstance(parameter, click.Option)]
        assert [option.opts for option in options if not option.help or option.help.startswith("[")] == [], name
