"""Runs as ROS 2 bags: every message is read again and compared with the run's own files."""

from __future__ import annotations

from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_run import (
    FRAMES,
    PLAN,
    STEPS,
    FrameTree,
    all_files,
    as_rollout,
    check_turn,
    labels_of,
    render_tiny,
    render_turn,
)

from unisim_blender.core.export.finished_run import FinishedRun
from unisim_blender.core.export.formats import write_run
from unisim_blender.core.geometry import make_pose

pytest.importorskip("rosbags", reason="the extra rosbag is not installed: pip install '.[rosbag]'")

Messages = dict[str, list[tuple[int, Any]]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return as_rollout(render_tiny(tmp_path_factory.mktemp("rosbag") / "out"))


@pytest.fixture(scope="module")
def messages(folder: Path) -> Messages:
    return read(write_run("rosbag", folder))


def read(path: Path) -> Messages:
    """A bag's messages by topic."""
    from rosbags.highlevel import AnyReader

    found: Messages = defaultdict(list)
    with AnyReader([path]) as reader:
        for connection, stamp, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            if hasattr(message, "header"):
                assert stamp_of(message.header) == stamp
            found[connection.topic].append((stamp, message))
    return found


def stamp_of(header: Any) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def numbers(pose: Any) -> tuple[list[float], list[float]]:
    position = pose.translation if hasattr(pose, "translation") else pose.position
    turn = pose.rotation if hasattr(pose, "rotation") else pose.orientation
    return [position.x, position.y, position.z], [turn.w, turn.x, turn.y, turn.z]


def test_nothing_else_is_in_it(messages: Messages) -> None:
    shots = len(FRAMES)
    assert Counter({topic: len(found) for topic, found in messages.items()}) == {
        "/camera/front/image/compressed": shots, "/camera/front/camera_info": shots, "/lidar/top/points": shots,
        "/boxes": shots, "/tf": 3 * shots + len(STEPS), "/tf_static": 1, "/ego/state": len(STEPS), "/ego/plan": 1,
    }  # fmt: skip


def test_images_and_points_are_the_files(folder: Path, messages: Messages) -> None:
    for frame, (_, image) in zip(FRAMES, messages["/camera/front/image/compressed"], strict=True):
        assert image.data.tobytes() == (folder / f"camera/front/{frame:06d}.png").read_bytes() and image.format == "png"
    kinds = {7: "<f4", 8: "<f8", 5: "<i4"}
    for frame, (_, cloud) in zip(FRAMES, messages["/lidar/top/points"], strict=True):
        layout = np.dtype(
            {
                "names": [field.name for field in cloud.fields],
                "formats": [kinds[field.datatype] for field in cloud.fields],
                "offsets": [field.offset for field in cloud.fields],
                "itemsize": cloud.point_step,
            }
        )
        points = np.frombuffer(cloud.data.tobytes(), layout)
        assert (cloud.width, cloud.height, cloud.row_step) == (len(points), 1, cloud.data.size)
        with np.load(folder / f"lidar/top/{frame:06d}.npz") as file:
            for name in ("x", "y", "z", "intensity", "ring", "time"):
                np.testing.assert_array_equal(points[name], file[name])


def tree_of(messages: Messages) -> FrameTree:
    tree = FrameTree()
    for topic, still in (("/tf", False), ("/tf_static", True)):
        for stamp, message in messages[topic]:
            for one in message.transforms:
                assert stamp_of(one.header) == stamp
                position, quaternion = numbers(one.transform)
                pose = make_pose(np.array(position), np.array(quaternion))
                tree.add(one.header.frame_id, one.child_frame_id, pose, None if still else stamp)
    return tree


def test_a_turn_is_one_in_every_frame_of_reference(tmp_path: Path) -> None:
    folder, drive = render_turn(tmp_path / "out")
    path = write_run("rosbag", folder)
    messages = read(path)
    frames: dict[int, set[str]] = defaultdict(set)
    for topic in messages:
        for stamp, message in messages[topic]:
            if hasattr(message, "header"):
                frames[stamp].add(message.header.frame_id)
            if hasattr(message, "child_frame_id"):
                frames[stamp].add(message.child_frame_id)
    twists = [(stamp, one.twist.twist.linear.x, one.twist.twist.angular.z) for stamp, one in messages["/ego/state"]]
    check_turn(tree_of(messages), frames, drive, twists)
    (profile,) = qos_of(path, "/tf_static")
    assert (profile.durability.name, profile.reliability.name) == ("TRANSIENT_LOCAL", "RELIABLE")
    assert not qos_of(path, "/tf")


def qos_of(path: Path, topic: str) -> list[Any]:
    """What a topic's publisher offered."""
    from rosbags.rosbag2 import Reader

    with Reader(path) as reader:
        (connection,) = [one for one in reader.connections if one.topic == topic]
        return list(connection.ext.offered_qos_profiles)  # type: ignore[union-attr]


def test_transforms_and_boxes_are_the_labels(folder: Path, messages: Messages) -> None:
    tree = tree_of(messages)
    for labels, (_, array) in zip(labels_of(folder), messages["/boxes"], strict=True):
        placed = {"ego": labels["world_from_ego"], **{f"actor/{box['id']}": box["world"] for box in labels["boxes"]}}
        placed |= {name: sensor["world_from_sensor"] for name, sensor in labels["sensors"].items()}
        for name, pose in placed.items():
            truth = make_pose(np.array(pose["position"]), np.array(pose["quaternion_wxyz"]))
            found = tree.in_world(name, round(labels["time_s"] * 1e9))
            np.testing.assert_allclose(found, truth, rtol=0, atol=1e-9)
        first, *marks = array.markers
        assert first.action == first.DELETEALL
        for mark, box in zip(marks, labels["boxes"], strict=True):
            assert (mark.text, mark.ns, mark.type) == (box["id"], box["class"], mark.CUBE)
            assert numbers(mark.pose) == (box["world"]["position"], box["world"]["quaternion_wxyz"])
            assert [mark.scale.x, mark.scale.y, mark.scale.z] == box["size_m"]


def test_calibration_and_rollout(folder: Path, messages: Messages) -> None:
    model = FinishedRun(folder).drive.cameras["front"].model
    for _, info in messages["/camera/front/camera_info"]:
        assert (info.width, info.height, info.distortion_model) == (model.width, model.height, "plumb_bob")
        wanted = [model.fx, 0, model.cx - 0.5, 0, model.fy, model.cy - 0.5, 0, 0, 1]
        np.testing.assert_array_equal(info.k, wanted)
    for step, (stamp, state) in zip(STEPS, messages["/ego/state"], strict=True):
        assert stamp == step.time_us * 1000 and state.twist.twist.linear.x == step.ego.speed_m_s
        assert numbers(state.pose.pose)[0][:2] == [step.ego.x_m, step.ego.y_m]
    ((stamp, path),) = messages["/ego/plan"]
    assert stamp == 0 and [stamp_of(one.header) // 1000 for one in path.poses] == PLAN.times_us.tolist()
    np.testing.assert_array_equal([numbers(one.pose)[0][:2] for one in path.poses], np.stack([PLAN.x_m, PLAN.y_m], -1))


def test_written_twice_is_the_same_bytes(folder: Path, messages: Messages) -> None:
    first = all_files(folder / "rosbag")
    assert set(first) == {"rosbag.mcap", "metadata.yaml"}
    assert all_files(write_run("rosbag", folder)) == first and not list(folder.glob(".rosbag*"))


def test_topics_have_the_letters_that_ros_has() -> None:
    from unisim_blender.core.formats.rosbag.ros import RosEncoder

    topics = RosEncoder()
    assert [topics.topic("camera", name) for name in ("front-left", "front_left", "0", "front-left")] == [
        "/camera/front_left", "/camera/front_left_2", "/camera/_0", "/camera/front_left",
    ]  # fmt: skip
