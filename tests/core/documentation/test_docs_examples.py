"""The documentation's examples: every Python and shell block runs in a copy of the sample, in the order of its page.

A block under `<!-- parsed only: REASON -->` is not run: its options are checked, its imports imported. Examples that
render or make a street run for a few small frames. Sections of the pages in `APART` are run each in a folder of its
own.
"""

from __future__ import annotations

import ast
import json
import shlex
import shutil
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner
from documentation_pages import PAGES, ROOT, Block, blocks
from written_street import write_recipe

from unisim_blender.core.cli.main import unisim
from unisim_blender.core.errors import what_is_missing
from unisim_blender.core.executors import EXECUTORS
from unisim_blender.core.formats.readers import READERS
from unisim_blender.core.formats.writers import WRITERS
from unisim_blender.core.lenses import LENSES
from unisim_blender.core.prepare.renderers import RENDERERS
from unisim_blender.core.presets import PRESETS
from unisim_blender.core.scenario import scenario_from_json
from unisim_blender.core.scenario.edit import EDITS
from unisim_blender.editing.edits.lines import PARTS
from unisim_blender.editing.edits.reader import ACTORS

SMALL = {
    "render": {"--width": "64", "--frames": "5", "--jobs": "1"},
    "eval": {"--width": "64", "--frames": "5"},
    "synth": {"--frames": "2", "--width": "64", "--height": "36", "--jobs": "1"},
}
"""What an example is run with, where it does not say so itself; a street's own size is always this one."""
APART = {"docs/reference/extending.md"}
"""Pages that promise that no section needs another."""


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample's log, its images and sweeps small."""
    return write_recipe(tmp_path_factory.mktemp("street") / "street", 180, frames=20, width=64, height=36)


@pytest.fixture
def folder(tmp_path: Path, street: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder like the repository's after `make demo`, with what examples name; what they register is taken back."""
    (tmp_path / "sample").mkdir()
    for path in (ROOT / "sample").glob("*.json"):
        shutil.copy(path, tmp_path / "sample")
    (tmp_path / "sample" / "scene").symlink_to(ROOT / "sample" / "scene")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "street").symlink_to(street)
    scenario = json.loads((ROOT / "sample" / "objects.json").read_text())
    scenario["log"]["path"], scenario["scene"] = "out/street", "sample/scene"
    scenario["edits"].append({"type": "remove", "actor": "car-05"})
    (tmp_path / "edited.json").write_text(json.dumps(scenario))
    for name in ("detections", "labels", "simulated", "real"):
        (tmp_path / f"{name}.json").write_text(json.dumps(autonomy_document()))
    monkeypatch.chdir(tmp_path)
    registries: tuple[dict[Any, Any], ...] = (EDITS, PARTS, READERS, WRITERS, LENSES, PRESETS, RENDERERS, EXECUTORS)
    before, actors = [dict(registry) for registry in registries], list(ACTORS)
    yield tmp_path
    for registry, entries in zip(registries, before, strict=True):
        registry.clear()
        registry.update(entries)
    ACTORS[:] = actors


def autonomy_document() -> dict[str, Any]:
    """The page's own document."""
    page = (ROOT / "docs" / "reference" / "metrics.md").read_text(encoding="utf-8")
    (found,) = [block for block in blocks(page) if block.language == "json"]
    document: dict[str, Any] = json.loads(found.text)
    return document


def sequences() -> Iterator[tuple[str, list[Block]]]:
    """Yield the name and the blocks of all examples that are run in one sequence: a page's, or a section's."""
    for page in PAGES:
        name, text = page.relative_to(ROOT).as_posix(), page.read_text(encoding="utf-8")
        found = [block for block in blocks(text) if block.language in ("python", "sh")]
        if name not in APART:
            yield name, found
            continue
        starts = [number for number, line in enumerate(text.splitlines(), 1) if line.startswith("## ")]
        for first, end in zip(starts, [*starts[1:], 10**6], strict=True):
            yield f"{name}:{first}", [block for block in found if first < block.line < end]


SEQUENCES = dict(sequences())


@pytest.mark.parametrize("name", SEQUENCES)
def test_examples_run(name: str, request: pytest.FixtureRequest) -> None:
    names: dict[str, Any] = {"__name__": "__main__"}
    found = SEQUENCES[name]
    if any(not block.reason for block in found):
        request.getfixturevalue("folder")
    for block in found:
        where = f"{name.partition(':')[0]}:{block.line}"
        if block.language == "python":
            python(block, where, names)
        else:
            for command in commands(block.text):
                shell(command, where, run=not block.reason)


def test_examples_are_checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The checks see what is wrong."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AssertionError, match="no such option"):
        shell(["unisim", "render", "scenario.json", "--out", "o", "--nothing"], "here", run=False)
    with pytest.raises(AssertionError, match="cannot be read"):
        shell(["unisim", "render", "out/none", "--out", "o"], "here", run=True)
    with pytest.raises(AssertionError, match="target"):
        shell(["make", "nothing"], "here", run=False)
    with pytest.raises((ImportError, AttributeError)):
        python(Block("python", "from unisim_blender.core.world.drive import Nothing\n", 1, "a reason"), "here", {})


def python(block: Block, where: str, names: dict[str, Any]) -> None:
    """Run a block, or import what it imports."""
    code = compile(block.text, where, "exec", dont_inherit=True)  # without this file's own __future__
    if not block.reason:
        try:
            exec(code, names)
        except ModuleNotFoundError as error:
            if not what_is_missing(error):
                raise
            pytest.skip(f"{where}: {what_is_missing(error)}")
        return
    for node in ast.walk(ast.parse(block.text)):
        if isinstance(node, ast.ImportFrom) and node.module:
            module = import_module(node.module)
            for alias in node.names:
                getattr(module, alias.name)
        elif isinstance(node, ast.Import):
            for alias in node.names:
                import_module(alias.name)


def commands(text: str) -> list[list[str]]:
    """Return a block's commands as lists of words."""
    joined = text.replace("\\\n", " ")
    return [words for line in joined.splitlines() if (words := shlex.split(line, comments=True))]


def shell(words: list[str], where: str, run: bool) -> None:
    """Run a command of ours, or check its options; of others, check that what they name is there."""
    while "=" in words[0] and not words[0].startswith("-"):
        words = words[1:]  # a variable of the environment
    program, *rest = words
    if program.endswith("unisim"):
        ours(rest, where, run)
    elif program == "make":
        targets = (ROOT / "Makefile").read_text()
        for target in rest:
            assert "=" in target or f"\n{target}:" in targets, f"{where}: make has no target {target}"
    elif program.startswith("python") or program.endswith("/python"):
        of_python(rest, where)
    elif program == "pip":
        assert rest[0] == "install", where
    else:
        assert program in ("blender", "carla-driver-interface", "ray", "sbatch", "kubectl"), (
            f"{where}: what is {program}?"
        )  # with options of their own


def ours(arguments: list[str], where: str, run: bool) -> None:
    """Run `unisim` small, or check its options."""
    name, rest = arguments[0], arguments[1:]
    if not run:
        check(unisim, name, rest, where)
        return
    small = SMALL.get(name, {})
    for option, value in small.items():
        if name == "synth" and option in rest:
            rest[rest.index(option) + 1] = value
        elif option not in rest and not (option == "--frames" and "--times" in rest):
            rest += [option, value]
    result = CliRunner().invoke(unisim, [name, *rest])
    sentence = f"{result.output}{result.exception or ''}"
    assert result.exit_code == 0 and result.exception is None, f"{where}: {' '.join([name, *rest])}: {sentence}"


def check(group: click.Command, name: str, arguments: list[str], where: str) -> None:
    """Have click read the options of a group's command, or of a command alone, without running it."""
    command = group.get_command(click.Context(group), name) if isinstance(group, click.Group) else group
    assert command is not None, f"{where}: there is no command {name}"
    try:
        command.make_context(name, list(arguments))
    except click.ClickException as error:
        raise AssertionError(f"{where}: {name}: {error.format_message().lower()}") from error


def of_python(arguments: list[str], where: str) -> None:
    """Check that the module or script of a `python` command is there, and has the options."""
    if arguments[0] != "-m":
        script = ROOT / arguments[0]
        assert script.is_file(), f"{where}: there is no {arguments[0]}"
        options = {word for word in arguments[1:] if word.startswith("--")}
        known = script.read_text(encoding="utf-8")
        assert [option for option in options if f'"{option}"' not in known] == [], f"{where}: {arguments[0]}"
        return
    name, rest = arguments[1], arguments[2:]
    assert find_spec(name) is not None, f"{where}: there is no module {name}"
    if name == "benchmarks.detection":
        check(import_module("benchmarks.detection.__main__").main, rest[0], rest[1:], where)


def test_scenarios_are_valid() -> None:
    """JSON blocks that are whole documents are read as such."""
    found = 0
    for page in PAGES:
        for block in blocks(page.read_text(encoding="utf-8")):
            if block.language == "json" and '"unisim-scenario"' in block.text:
                scenario_from_json(json.loads(block.text))
                found += 1
    assert found >= 2
