"""Samples of nuScenes' layout: which image goes with a sweep, which boxes, and under which name tools find the scene."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_log import small_drive, write_small_log

from unisim_blender.core.convert import Converted, convert, open_source
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.formats.writers import writer_named
from unisim_blender.core.geometry import Trajectory, invert_pose, make_pose, quaternion_from_matrix
from unisim_blender.core.world.drive import Drive

SIDES = {
    "front": np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]),
    "left": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "right": np.array([[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]]),
}
"""A camera's axes when it looks to a side. The LiDAR turns clockwise, from backward: it passes left, front, right after 25, 50
and 75 ms of a sweep that ends at its frame's time."""


def drive_of(side: str, late_s: float) -> Drive:
    """The small drive at 10 Hz with a camera that looks to a side, its images stamped ``late_s`` after their frames."""
    drive = small_drive()
    time_s = {frame: 0.1 * frame for frame in range(10)}
    camera, lidar = drive.cameras["front_camera"], drive.lidars["pandar64"]
    stamps = {frame: time + late_s for frame, time in time_s.items()}
    times = np.array(list(time_s.values()))
    ego = Trajectory.from_poses(times, drive.world_from_ego.at(times))
    above = invert_pose(ego.at(0.0)) @ lidar.world_from_lidar.at(0.0)
    mount = make_pose(np.array([1.5, 0.0, 1.5]), quaternion_from_matrix(SIDES[side]))
    keys = np.linspace(-0.3, 1.2, 76)
    track = Trajectory.from_poses(keys, ego.at(keys) @ mount)
    model = replace(camera.model, shutter=replace(camera.model.shutter, duration_s=0.0))
    actors = {uid: replace(actor, start_s=0.0, end_s=2.0) for uid, actor in drive.actors.items()}
    return replace(
        drive,
        frames=tuple(time_s),
        time_s=time_s,
        world_from_ego=ego,
        actors=actors,
        cameras={"front_camera": replace(camera, model=model, world_from_camera=track, time_s=stamps)},
        lidars={"pandar64": replace(lidar, time_s=time_s, world_from_lidar=ego.transformed(right=above))},
    )


def written(
    drive: Drive, root: Path, without: tuple[int, ...] = ()
) -> tuple[Converted, dict[str, list[dict[str, Any]]]]:
    """What was converted, and its tables."""
    write_small_log(root / "log", drive)
    for frame in without:
        (root / f"log/camera/front_camera/{frame:02d}.jpg").unlink()
    done = convert(open_source(root / "log"), writer_named("nuscenes"), root / "out")
    return done, {path.stem: json.loads(path.read_text()) for path in (done.opens / "v1.0-mini").glob("*.json")}


def key_stamps(tables: dict[str, list[dict[str, Any]]], channel: str) -> dict[int, int]:
    """Stamps of a channel's key captures by their samples'."""
    sample = {row["token"]: row["timestamp"] for row in tables["sample"]}
    return {
        sample[row["sample_token"]]: row["timestamp"]
        for row in tables["sample_data"]
        if row["is_key_frame"] and f"/{channel}/" in row["filename"]
    }


@pytest.mark.parametrize(
    ("side", "channel", "late_s", "wanted_s"),
    [
        ("left", "CAM_BACK_LEFT", -0.095, -0.095),  # the next is nearer to the sweep's end, by 90 ms
        ("left", "CAM_BACK_LEFT", 0.015, -0.085),
        ("front", "CAM_FRONT", -0.07, -0.07),
        ("front", "CAM_FRONT", 0.04, -0.06),
        ("right", "CAM_BACK_RIGHT", -0.03, -0.03),
        ("right", "CAM_BACK_RIGHT", 0.03, -0.07),
    ],
)
def test_a_sample_has_the_image_that_is_taken_as_the_beams_pass(
    side: str, channel: str, late_s: float, wanted_s: float, tmp_path: Path
) -> None:
    done, tables = written(drive_of(side, late_s), tmp_path)
    pairs = sorted(key_stamps(tables, channel).items())
    assert [round((sweep - pairs[0][0]) / 1e5) for sweep, _ in pairs] == [0, 5, 9]
    # the last column is fired half a column before its sweep's end
    ways = [(image - sweep) * 1e-6 - 0.5 * 0.1 / 90 for sweep, image in pairs]
    # where a drive ends there is no image before it or after it
    inner = ways[1:] if wanted_s < late_s else ways
    np.testing.assert_allclose(inner, wanted_s, rtol=0, atol=2e-5)
    assert any("more than 50 ms" in loss for loss in done.losses) == (wanted_s < late_s)


def test_boxes_of_a_sample_are_where_its_images_show_them(tmp_path: Path) -> None:
    """A car that drives past at 15 m/s, seen by a camera to the left: nearer to its place than 15 m/s times half a period."""
    drive = drive_of("left", -0.095)
    car = drive.actors["car-1"]
    keys = np.linspace(0.0, 1.0, 11)
    places = np.stack([-6 + 15 * keys, 0 * keys + 9.0, 0 * keys + 0.8], -1)
    moving = replace(car, world_from_actor=Trajectory(keys, places, np.tile([1.0, 0, 0, 0], (11, 1))))
    drive = replace(drive, actors={"car-1": moving})
    _, tables = written(drive, tmp_path)
    stamps = key_stamps(tables, "CAM_BACK_LEFT")
    first = next(row["timestamp"] for row in tables["sample"])
    sample = {row["token"]: row["timestamp"] for row in tables["sample"]}
    assert len(tables["sample_annotation"]) == 3
    for row in tables["sample_annotation"]:
        stamp = stamps[sample[row["sample_token"]]]
        exposed_s = (stamp - first) * 1e-6 - 0.5 * 0.1 / 90
        place = np.array(row["translation"]) - drive.world_origin
        shown = moving.world_from_actor.at(exposed_s)[:3, 3]
        assert np.abs(place - shown).max() < 15 * 0.05
        # where the beams passed it
        lidar = drive.lidars["pandar64"].world_from_lidar
        local = (invert_pose(lidar.at(exposed_s)) @ np.append(place, 1.0))[:3]
        assert np.arctan2(local[1], local[0]) > 0.3


def test_a_key_frame_is_where_there_are_images(tmp_path: Path) -> None:
    done, tables = written(drive_of("front", -0.05), tmp_path, without=(1, 3, 5, 7, 9))
    pairs = sorted(key_stamps(tables, "CAM_FRONT").items())
    offsets = [abs(image - sweep + 50_000) for sweep, image in pairs]
    assert max(offsets[:-1]) < 2000, "the fifth sweep, half a second after the first, has no image"
    assert len(pairs) == len(tables["sample"]) == 3  # 0, 0.4 s and the drive's last
    assert sum("1 of 3 key images were exposed more than 50 ms (up to 101 ms)" in loss for loss in done.losses) == 1


def test_an_image_is_of_one_sample(tmp_path: Path) -> None:
    done, tables = written(drive_of("front", -0.05), tmp_path, without=tuple(range(1, 10)))
    data = [row for row in tables["sample_data"] if "/CAM_FRONT/" in row["filename"]]
    assert len(data) == 1 and data[0]["is_key_frame"] and data[0]["sample_token"] == tables["sample"][0]["token"]
    assert sum("2 of 3 key frames have no image" in loss for loss in done.losses) == 1


def test_the_first_and_the_last_sample_have_boxes(tmp_path: Path) -> None:
    """Actors that are there from the first frame to the last, to the second: the first sweep begins before that."""
    drive = drive_of("front", -0.05)
    actors = {uid: replace(actor, end_s=drive.time_s[9]) for uid, actor in drive.actors.items()}
    _, tables = written(replace(drive, actors=actors), tmp_path)
    for sample in tables["sample"]:
        boxes = [row for row in tables["sample_annotation"] if row["sample_token"] == sample["token"]]
        assert {row["instance_token"] for row in boxes} == set(actors)


def test_tools_find_the_scene_by_a_name_of_their_splits(tmp_path: Path) -> None:
    done, tables = written(drive_of("front", -0.05), tmp_path / "own")
    (scene,) = tables["scene"]
    name = open_log(tmp_path / "own/log").drive.name
    assert (scene["name"], scene["description"]) == ("scene-0103", name) and name != "scene-0103"
    assert json.loads((done.opens / "v1.0-mini/splits.json").read_text()) == {"converted": ["scene-0103"]}
    assert any(f"scene-0103, which predefined splits list; {name}" in loss for loss in done.losses)
    assert any("no CAN bus is written" in loss for loss in done.losses)
    assert open_log(done.opens).drive.name == name, "read back it has its own name"
    table = done.opens / "v1.0-mini/scene.json"
    table.write_text(table.read_text().replace("scene-0103", "scene-0061"))  # in mini_train
    assert open_log(done.opens).drive.name == name
    _, tables = written(replace(drive_of("front", -0.05), name="scene-0796"), tmp_path / "dataset's")
    assert tables["scene"][0]["name"] == "scene-0796"
