"""One recording in four layouts, as the benchmark of layouts trains it: what readers give of it is alike."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[3] / "benchmarks"))

pytest.importorskip("ncore", reason="the extra ncore is not installed")

from layout_logs.kitti_log import write_kitti
from layout_logs.nuscenes_log import write_nuscenes
from layout_logs.recording import CAMERA, LIDAR, Size, make_recording, write_ncore, write_pandaset

from unisim_blender.core.data.log import Log
from unisim_blender.core.formats.readers import open_log

FRAMES, FRAME = 5, 2
LAYOUTS = {
    "ncore": (write_ncore, CAMERA, LIDAR, 1e-6),
    "kitti": (write_kitti, "image_02", "velodyne", 1.2e-3),
    "nuscenes": (write_nuscenes, "CAM_FRONT", "LIDAR_TOP", 3e-5),
}
"""Of each: its writer, its sensors' names, and to how many metres it keeps a return."""


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Log]:
    folder = tmp_path_factory.mktemp("alike")
    recording = make_recording(Size(frames=FRAMES, width=48, height=32))
    recording.draw()
    writers = {"pandaset": write_pandaset, **{name: layout[0] for name, layout in LAYOUTS.items()}}
    return {name: open_log(write(recording, folder / name)) for name, write in writers.items()}


@pytest.mark.parametrize("name", LAYOUTS)
def test_images_sweeps_and_boxes_are_those_of_pandasets_layout(logs: dict[str, Log], name: str) -> None:
    _, camera_id, lidar_id, precision = LAYOUTS[name]
    log, reference = logs[name], logs["pandaset"]
    camera, known = log.drive.cameras[camera_id], reference.drive.cameras[CAMERA]
    later = camera.time_s[FRAME] - known.time_s[FRAME]  # clocks begin with different sensors
    np.testing.assert_array_equal(log.image(camera_id, FRAME), reference.image(CAMERA, FRAME))
    for value in ("width", "height", "fx", "fy", "cx", "cy"):
        assert getattr(camera.model, value) == pytest.approx(getattr(known.model, value), abs=1e-5)
    pose = camera.world_from_camera.at(camera.time_s[FRAME])
    expected = known.world_from_camera.at(known.time_s[FRAME])
    shift = pose[:3, 3] - expected[:3, 3]  # so do worlds
    assert np.linalg.norm(shift) < 1e-3
    np.testing.assert_allclose(pose[:3, :3], expected[:3, :3], atol=1e-6)
    grid, truth = log.sweep_grid(lidar_id, FRAME), reference.sweep_grid(LIDAR, FRAME)
    np.testing.assert_array_equal(grid.returned, truth.returned)
    assert truth.returned.mean() > 0.9 and not grid.blocked.any() and (~truth.returned).sum() > 100
    back = truth.returned
    points = (grid.origins - shift + grid.directions * grid.depth_m[..., None])[back]
    np.testing.assert_allclose(
        points, (truth.origins + truth.directions * truth.depth_m[..., None])[back], atol=precision
    )
    np.testing.assert_allclose(grid.time_s - later, truth.time_s, atol=6e-6)
    np.testing.assert_allclose(grid.directions[~back], truth.directions[~back], atol=1e-3)
    places = {actor.uid: actor.world_from_actor.at(FRAME / 10)[:3, 3] for actor in reference.drive.actors.values()}
    found = [actor.world_from_actor.at(FRAME / 10 + later)[:3, 3] - shift for actor in log.drive.actors.values()]
    assert len(found) == len(places) > 8
    for place in places.values():
        assert np.linalg.norm(np.array(found) - place, axis=1).min() < 0.02
