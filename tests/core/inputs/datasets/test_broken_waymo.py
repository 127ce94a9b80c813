"""Waymo Open's segments with faults: tables of poses, calibrations, images, range images, boxes."""

from __future__ import annotations

import sys
from pathlib import Path
from unittest.mock import patch

import pytest
from hypothesis import example, given

from inputs.datasets.logs import layout
from inputs.faults import Bytes
from inputs.strategies import Input
from inputs.views import In

pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
pytest.importorskip("scipy", reason="the extra torch is not installed")

import waymo_street  # noqa: E402

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no alarms and no bounds of memory there")


def write(folder: Path) -> Path:
    # a document of every cell of a range image: so many are enough
    with patch.object(waymo_street, "COLUMNS", 20):
        waymo_street.WaymoStreet(frames=2).write(folder / "training")
    return folder / "training"


WAYMO = layout(write, lambda name: ["parquet"])


CALIBRATION = "training/lidar_calibration/segment-1000_0_1020_0.parquet"


@given(WAYMO.inputs)
@example([In(CALIBRATION, "bytes", (Bytes(at=161, length=1, data=b"\x00"),))])
def test_segments_of_waymo(changes: Input) -> None:
    WAYMO.check(changes)
