"""nuScenes' scenes with faults: tables, sweeps, images."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from hypothesis import given

from inputs.datasets.logs import layout
from inputs.strategies import Input

pytest.importorskip("scipy", reason="the extra torch is not installed")

import nuscenes_street  # noqa: E402

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no alarms and no bounds of memory there")


def write(folder: Path) -> Path:
    nuscenes_street.write(folder / "nuscenes", traced=False)
    return folder / "nuscenes"


def views(name: str) -> list[str]:
    return ["json"] if name.endswith(".json") else ["points of 5"] if name.endswith(".bin") else []


NUSCENES = layout(write, views)


@given(NUSCENES.inputs)
def test_scenes_of_nuscenes(changes: Input) -> None:
    NUSCENES.check(changes)
