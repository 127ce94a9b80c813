"""A log whose tables of boxes are there and hold no row is opened, in every layout, and has no actors."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas
import pytest
from street_layouts import LAYOUTS

from unisim_blender.core.formats.readers import open_log


def _pandaset(root: Path) -> int:
    files = list((root / "annotations" / "cuboids").glob("*.pkl.gz"))
    for file in files:
        pandas.read_pickle(file).iloc[:0].to_pickle(file)
    return len(files)


def _feather(root: Path) -> int:
    import pyarrow.feather as feather

    (file,) = root.rglob("annotations.feather")
    table = feather.read_table(file)
    feather.write_feather(table.slice(0, 0), str(file))
    return len(table)


def _waymo(root: Path) -> int:
    from pyarrow import parquet

    (file,) = (root / "lidar_box").glob("*.parquet")
    table = parquet.read_table(file)
    parquet.write_table(table.slice(0, 0), file)
    return len(table)


def _nuscenes(root: Path) -> int:
    files = [*root.rglob("sample_annotation.json"), *root.rglob("instance.json")]
    for file in files:
        file.write_text(json.dumps([]))
    return len(files)


def _kitti(root: Path) -> int:
    (file,) = root.rglob("tracklet_labels.xml")
    text = re.sub(r"<item>\s*<objectType>.*(?=</tracklets>)", "", file.read_text(), flags=re.DOTALL)
    file.write_text(re.sub(r"<count>\d+</count>", "<count>0</count>", text, count=1))
    assert "objectType" not in text
    return 1


EMPTIED: dict[str, Callable[[Path], int]] = {
    "pandaset": _pandaset, "argoverse2": _feather, "waymo": _waymo, "nuscenes": _nuscenes, "kitti": _kitti,
}  # fmt: skip


@pytest.mark.parametrize("layout", EMPTIED)
def test_tables_of_boxes_without_rows(layout: str, tmp_path: Path) -> None:
    written = LAYOUTS[layout](tmp_path / "log", 1)
    assert open_log(written.log).drive.actors
    assert EMPTIED[layout](tmp_path / "log")
    log = open_log(written.log)
    assert log.drive.actors == {}
    assert np.isfinite(log.drive.world_from_ego.positions).all()
