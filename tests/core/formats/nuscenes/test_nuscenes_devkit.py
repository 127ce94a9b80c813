"""nuScenes' own development kit opens what is converted; it is no requirement of this package, and skipped where it is not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from small_log import write_small_log

from unisim_blender.core.convert import convert, open_source
from unisim_blender.core.data.log import Log
from unisim_blender.core.formats.writers import writer_named

nuscenes = pytest.importorskip("nuscenes.nuscenes", reason="nuscenes-devkit is not installed")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Log, Any]:
    """A small log, and the dataset that it was converted to."""
    root = tmp_path_factory.mktemp("devkit")
    write_small_log(root / "log")
    source = open_source(root / "log")
    done = convert(source, writer_named("nuscenes"), root / "out")
    return source.log, nuscenes.NuScenes(version="v1.0-mini", dataroot=str(done.opens), verbose=False)


def test_scenes_samples_and_boxes_are_found(made: tuple[Log, Any], capsys: pytest.CaptureFixture[str]) -> None:
    log, data = made
    data.list_scenes()
    assert log.drive.name in capsys.readouterr().out
    sample = data.sample[0]
    assert set(sample["data"]) == {"LIDAR_TOP", "CAM_FRONT"}
    named = {data.get("sample_annotation", one)["instance_token"] for one in sample["anns"]}
    assert named == {"car-1", "van"}  # the cone comes later
    assert len(data.sample) == 2
    for annotation in data.sample_annotation:
        box, actor = data.get_box(annotation["token"]), log.drive.actors[annotation["instance_token"]]
        np.testing.assert_allclose(box.wlh[[1, 0, 2]], actor.size_m)
        assert data.get("visibility", annotation["visibility_token"])["level"].startswith("v")
        alone = annotation["instance_token"] == "cone"
        assert np.isfinite(data.box_velocity(annotation["token"])).all() != alone


def test_points_fall_into_the_image_where_the_log_puts_them(made: tuple[Log, Any]) -> None:
    log, data = made
    sample = data.sample[0]
    seen, depth, image = data.explorer.map_pointcloud_to_image(sample["data"]["LIDAR_TOP"], sample["data"]["CAM_FRONT"])
    (camera,), (lidar,) = log.drive.cameras.values(), log.drive.lidars.values()
    assert image.size == (camera.model.width, camera.model.height) and len(depth) > 20
    frame = log.drive.frames[0]
    start, end = camera.model.shutter.exposure_s(camera.time_s[frame])
    pose = np.linalg.inv(camera.world_from_camera.at((start + end) / 2))
    points = log.sweep(lidar.sensor_id, frame).points @ pose[:3, :3].T + pose[:3, 3]
    u, v, ahead = camera.model.project(points)
    # the devkit counts pixels from the first one's centre
    mine = np.stack([u - 0.5, v - 0.5], 1)[ahead]
    apart = np.linalg.norm(seen[:2].T[:, None] - mine[None], axis=2)
    assert apart.min(1).max() < 0.05
    np.testing.assert_allclose(depth, points[ahead, 2][apart.argmin(1)], atol=0.02)
    _, boxes, matrix = data.get_sample_data(sample["data"]["CAM_FRONT"])
    np.testing.assert_allclose(np.diag(matrix), [camera.model.fx, camera.model.fy, 1])
    for box in boxes:
        assert box.center[2] > 0


def test_the_split_is_known(made: tuple[Log, Any]) -> None:
    from nuscenes.utils.splits import get_scenes_of_split

    log, data = made
    assert get_scenes_of_split("converted", data) == ["scene-0103"]
    assert "scene-0103" in get_scenes_of_split("mini_val", data)
