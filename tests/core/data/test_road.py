"""Where the road is, by the semantic classes of a log's sweeps."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from small_log import small_sweep, write_small_log

from unisim_blender.core.data.road import CELL_M, RoadCells, road_cells
from unisim_blender.core.formats.readers import open_log


@pytest.fixture(scope="module")
def log_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("road") / "bend"
    write_small_log(folder)
    return folder


def test_returns_of_road_make_it(log_path: Path) -> None:
    """Of the four beams' classes, vegetation and ground are no road, road and lane markings are."""
    log = open_log(log_path)
    cells = road_cells(log)
    assert cells is not None and not np.isin(cells.other, cells.road).any()
    # the vehicle goes two metres in four frames: some sweeps are left out, the first one never
    sweep = small_sweep(log.drive, 0)
    on, known = cells.look_up(sweep.points[:, :2])
    assert known.all() and on[sweep.ring >= 2].all() and not on[sweep.ring < 2].all()
    assert not np.logical_or(*cells.look_up(np.array([[500.0, 0.0]]))).any()


def test_cells_without_returns_are_like_those_around() -> None:
    """Two cells that touch at a corner, road at 0, 0 and a kerb at 3, 0, on both sides of the axes."""
    shift = np.int64(1) << 32
    cells = RoadCells(np.array([-shift - 1, 0]), np.array([3 * shift]))
    at = (np.array([[0, 0], [-1, -1], [1, 1], [-2, 0], [3, 0], [4, 1], [2, 0], [6, 0]]) + 0.5) * CELL_M
    on, known = cells.look_up(at)
    assert on.tolist() == [True, True, True, True, False, False, False, False]
    assert known.tolist() == [True, True, True, True, True, True, True, False]


def test_a_log_without_classes_has_none(log_path: Path, tmp_path: Path) -> None:
    shutil.copytree(log_path, tmp_path / "bend", ignore=shutil.ignore_patterns("semseg"))
    assert road_cells(open_log(tmp_path / "bend")) is None
