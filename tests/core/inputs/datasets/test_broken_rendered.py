"""Folders that sequences were rendered into with faults: the drive, what was rendered when, sweeps, images."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from tiny_drive import tiny_plan

from inputs.datasets.logs import layout, read_through
from inputs.strategies import Input
from unisim_blender.core.formats.rendered import RenderedLog
from unisim_blender.core.sequence.run import render_sequence

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no alarms and no bounds of memory there")


def write(folder: Path) -> Path:
    plan = tiny_plan(width=64)
    render_sequence(replace(plan, moments=tuple(plan.moments[frame] for frame in (1, 2))), folder / "out")
    return folder / "out"


def views(name: str) -> list[str]:
    return {".json": ["json"], ".npz": ["npz"]}.get(Path(name).suffix, [])


def of_the_log(name: str) -> bool:
    """Whether a file is one that the log reads: no label, no record, no depth."""
    path = Path(name)
    return path.name in ("drive.json", "manifest.json") or (
        path.parts[1] in ("camera", "lidar") and name[-3:] in "npz png"
    )


RENDERED = layout(write, views, of_the_log, lambda path: read_through(RenderedLog(path)))


@given(RENDERED.inputs)
def test_folders_of_rendered_sequences(changes: Input) -> None:
    RENDERED.check(changes)
