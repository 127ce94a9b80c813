"""KITTI's drives with faults, raw and tracking: calibration, times, records, boxes, sweeps, images."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from hypothesis import given

from inputs.datasets.logs import layout
from inputs.profiles import COSTLY
from inputs.strategies import Input

pytest.importorskip("scipy", reason="the extra torch is not installed")

import kitti_street  # noqa: E402

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no alarms and no bounds of memory there")


def raw(folder: Path) -> Path:
    made = kitti_street.record(folder / "2011_09_26" / "drive", 1)
    kitti_street.write_raw(made)
    return made.path


def tracking(folder: Path) -> Path:
    made = kitti_street.record(folder / "day" / "drive", 1)
    path = kitti_street.write_tracking(made, folder / "training")
    for sweep in (folder / "training" / "velodyne").rglob("*.bin"):
        content = sweep.read_bytes()
        sweep.unlink()
        sweep.write_bytes(content)
    return path


def views(name: str) -> list[str]:
    return {".txt": ["words"], ".bin": ["points of 4"], ".xml": ["tags"]}.get(Path(name).suffix, [])


RAW, TRACKING = layout(raw, views), layout(tracking, views, lambda name: name.startswith("training"))


@COSTLY
@given(RAW.inputs)
def test_raw_drives_of_kitti(changes: Input) -> None:
    RAW.check(changes)


@COSTLY
@given(TRACKING.inputs)
def test_tracking_sequences_of_kitti(changes: Input) -> None:
    TRACKING.check(changes)
