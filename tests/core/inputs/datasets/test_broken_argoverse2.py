"""Argoverse 2's logs with faults: tables, images, names."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from hypothesis import given

from inputs.datasets.logs import layout
from inputs.strategies import Input

pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
pytest.importorskip("scipy", reason="the extra torch is not installed")

from argoverse2_street import Argoverse2Street  # noqa: E402

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no alarms and no bounds of memory there")


def write(folder: Path) -> Path:
    """A log of two sweeps."""
    path = folder / "adcf7d18-0510-35b0-a2fa-b4cea13a6d76"
    Argoverse2Street(sweeps=2).write(path)
    return path


def views(name: str) -> list[str]:
    return ["feather"] if name.endswith(".feather") else []


ARGOVERSE2 = layout(write, views)


@given(ARGOVERSE2.inputs)
def test_logs_of_argoverse2(changes: Input) -> None:
    ARGOVERSE2.check(changes)
