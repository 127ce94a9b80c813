"""Waymo Open's segments with faults: tables of poses, calibrations, images, range images, boxes."""

from __future__ import annotations

import sys
from pathlib import Path
from unittest.mock import patch

import pytest
from hypothesis import given

from inputs.datasets.logs import layout
from inputs.strategies import Input

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


@given(WAYMO.inputs)
def test_segments_of_waymo(changes: Input) -> None:
    WAYMO.check(changes)
