"""A scene for AlpaSim's runtime: what its reader asks of the zip's members, and that they agree with the drive."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from written_street import write_street

from unisim_blender.core.cli.main import run
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import make_pose


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_street(tmp_path_factory.mktemp("alpasim") / "street", 3, columns=300)


@pytest.fixture(scope="module")
def members(log: Path) -> dict[str, Any]:
    out = log.parent / "out"
    assert run(["convert", str(log), "--to", "alpasim", "--out", str(out)]) == 0
    with zipfile.ZipFile(out / "street.usdz") as archive:
        found: dict[str, Any] = {name: archive.read(name) for name in archive.namelist()}
    return {name: data if name.endswith(".ply") else json.loads(data) for name, data in found.items()}


def test_metadata(members: dict[str, Any]) -> None:
    about = members["metadata.yaml"]
    assert about["scene_id"] == "street" and about["sensors"]["camera_ids"] == ["front_camera"]
    wanted = {
        "scene_id",
        "version_string",
        "training_date",
        "dataset_hash",
        "uuid",
        "is_resumable",
        "logger",
        "time_range",
    }
    assert wanted <= about.keys()


def test_the_rig(members: dict[str, Any], log: Path) -> None:
    rig, drive = members["rig_trajectories.json"], open_log(log).drive
    (trajectory,) = rig["rig_trajectories"]
    times, poses = trajectory["T_rig_world_timestamps_us"], np.array(trajectory["T_rig_worlds"])
    assert times == sorted(set(times)) and poses.shape == (len(times), 4, 4)
    assert np.allclose(poses[-1], drive.world_from_ego.at(times[-1] / 1e6), atol=0.05)
    ((camera, images),) = trajectory["cameras_frame_timestamps_us"].items()
    assert rig["camera_calibrations"][camera]["logical_sensor_name"] == "front_camera"
    assert len(images) == 2 and all(0 <= start < end for start, end in images)
    assert np.array_equal(rig["world_to_nre"]["matrix"], np.eye(4))


def test_the_tracks(members: dict[str, Any], log: Path) -> None:
    (tracks,) = members["sequence_tracks.json"].values()
    data, drive = tracks["tracks_data"], open_log(log).drive
    moving = {
        uid for uid, flags in zip(data["tracks_id"], data["tracks_flags"], strict=True) if "CONTROLLABLE" in flags
    }
    assert moving == {uid for uid, actor in drive.actors.items() if actor.is_moving} and len(moving) < len(drive.actors)
    assert set(data["tracks_id"]) == drive.actors.keys()
    each = zip(data["tracks_id"], data["tracks_timestamps_us"], data["tracks_poses"], strict=True)
    for uid, times, poses in each:
        x, y, z, qx, qy, qz, qw = poses[-1]
        mine = make_pose(np.array([x, y, z]), np.array([qw, qx, qy, qz]))
        assert len(times) == len(poses) > 1
        assert np.allclose(mine, drive.actors[uid].world_from_actor.at(times[-1] / 1e6), atol=1e-5)


def test_the_ground(members: dict[str, Any]) -> None:
    assert members["mesh.ply"] == members["mesh_ground.ply"]
    mesh: Any = trimesh.load(io.BytesIO(members["mesh.ply"]), file_type="ply")
    assert len(mesh.faces) > 1000 and np.isfinite(mesh.vertices).all()
    near = mesh.vertices[np.hypot(mesh.vertices[:, 0] - 3, mesh.vertices[:, 1]) < 4]
    assert len(near) > 20 and np.abs(near[:, 2]).max() < 0.3
    assert (mesh.face_normals[:, 2] > 0).all()


def test_the_same_bytes_again(log: Path, members: dict[str, Any], tmp_path: Path) -> None:
    assert run(["convert", str(log), "--to", "alpasim", "--out", str(tmp_path / "again")]) == 0
    first, again = ((folder / "street.usdz").read_bytes() for folder in (log.parent / "out", tmp_path / "again"))
    assert first == again and len(members) == 5
