"""Runs as MCAP: every message is decoded again and compared with the run's own files."""

from __future__ import annotations

import io
import json
import time
from collections import Counter, defaultdict
from dataclasses import replace
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
from PIL import Image

from unisim_blender.core.errors import OutputError
from unisim_blender.core.export.finished_run import FinishedRun
from unisim_blender.core.export.formats import check_formats, write_run
from unisim_blender.core.geometry import make_pose
from unisim_blender.core.sequence.plan import SequenceSettings

pytest.importorskip("mcap_protobuf", reason="the extra mcap is not installed: pip install '.[mcap]'")

Messages = dict[str, list[tuple[int, Any]]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return as_rollout(render_tiny(tmp_path_factory.mktemp("mcap") / "out"))


def decoded(path: Path) -> tuple[Messages, dict[str, str]]:
    """Log times and messages by topic, and the metadata."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    found: Messages = defaultdict(list)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, content in reader.iter_decoded_messages():
            assert message.publish_time == message.log_time
            if hasattr(content, "timestamp"):
                assert content.timestamp.ToNanoseconds() == message.log_time
            found[channel.topic].append((message.log_time, content))
        (metadata,) = reader.iter_metadata()
    return found, dict(metadata.metadata)


@pytest.fixture(scope="module")
def messages(folder: Path) -> Messages:
    return decoded(write_run("mcap", folder))[0]


def xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def wxyz(quaternion: Any) -> list[float]:
    return [quaternion.w, quaternion.x, quaternion.y, quaternion.z]


def test_nothing_else_is_in_it(messages: Messages) -> None:
    shots = len(FRAMES)
    assert Counter({topic: len(found) for topic, found in messages.items()}) == {
        "/camera/front/image": shots, "/camera/front/calibration": shots, "/lidar/top/points": shots,
        "/boxes": shots, "/tf": 3 * shots + len(STEPS), "/tf_static": 1, "/ego/state": len(STEPS), "/ego/plan": 1,
    }  # fmt: skip


def test_images_are_the_files(folder: Path, messages: Messages) -> None:
    for frame, (time_ns, image) in zip(FRAMES, messages["/camera/front/image"], strict=True):
        path = folder / f"camera/front/{frame:06d}.png"
        assert image.data == path.read_bytes() and (image.format, image.frame_id) == ("png", "front")
        assert time_ns == frame * 100_000_000
        pixels = np.asarray(Image.open(io.BytesIO(image.data)))
        np.testing.assert_array_equal(pixels, np.asarray(Image.open(path)))


def test_points_are_the_files(folder: Path, messages: Messages) -> None:
    from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField

    kinds = {PackedElementField.FLOAT32: "<f4", PackedElementField.FLOAT64: "<f8", PackedElementField.INT32: "<i4"}
    for frame, (_, cloud) in zip(FRAMES, messages["/lidar/top/points"], strict=True):
        layout = np.dtype(
            {
                "names": [field.name for field in cloud.fields],
                "formats": [kinds[field.type] for field in cloud.fields],
                "offsets": [field.offset for field in cloud.fields],
                "itemsize": cloud.point_stride,
            }
        )
        points = np.frombuffer(cloud.data, layout)
        assert cloud.frame_id == "top" and wxyz(cloud.pose.orientation) == [1, 0, 0, 0]
        with np.load(folder / f"lidar/top/{frame:06d}.npz") as file:
            assert len(points) == len(file["x"]) > 50
            for name in ("x", "y", "z", "intensity", "ring", "time"):
                np.testing.assert_array_equal(points[name], file[name])
            names, all_names = ["", *file["instances"].tolist()], ["", *FinishedRun(folder).instances]
            theirs = [names[number] for number in file["instance"]]
            assert [all_names[number] for number in points["instance"]] == theirs and len(set(theirs)) > 1


def tree_of(messages: Messages) -> FrameTree:
    tree = FrameTree()
    for topic, still in (("/tf", False), ("/tf_static", True)):
        for time_ns, message in messages[topic]:
            for one in message.transforms:
                assert one.timestamp.ToNanoseconds() == time_ns
                pose = make_pose(np.array(xyz(one.translation)), np.array(wxyz(one.rotation)))
                tree.add(one.parent_frame_id, one.child_frame_id, pose, None if still else time_ns)
    return tree


def test_transforms_are_the_labels(folder: Path, messages: Messages) -> None:
    tree = tree_of(messages)
    for labels in labels_of(folder):
        placed = {"ego": labels["world_from_ego"], **{f"actor/{box['id']}": box["world"] for box in labels["boxes"]}}
        placed |= {name: sensor["world_from_sensor"] for name, sensor in labels["sensors"].items()}
        assert {"ego", "front", "top"} < set(placed)
        for name, pose in placed.items():
            truth = make_pose(np.array(pose["position"]), np.array(pose["quaternion_wxyz"]))
            found = tree.in_world(name, round(labels["time_s"] * 1e9))
            np.testing.assert_allclose(found, truth, rtol=0, atol=1e-9)
    ((time_ns, mounts),) = messages["/tf_static"]
    assert time_ns == 0 and {(one.parent_frame_id, one.child_frame_id) for one in mounts.transforms} == {
        ("ego", "front"),
        ("ego", "top"),
    }


def test_a_turn_is_one_in_every_frame_of_reference(tmp_path: Path) -> None:
    folder, drive = render_turn(tmp_path / "out")
    messages, metadata = decoded(write_run("mcap", folder))
    frames: dict[int, set[str]] = defaultdict(set)
    for topic in messages:
        for time_ns, message in messages[topic]:
            frames[time_ns] |= {
                getattr(message, name) for name in ("frame_id", "body_frame_id") if hasattr(message, name)
            }
    twists = [(time_ns, one.linear_velocity.x, one.angular_velocity.z) for time_ns, one in messages["/ego/state"]]
    check_turn(tree_of(messages), frames, drive, twists)
    moves = json.loads(metadata["mounts_move"])
    assert set(moves) == {"front", "top"} and max(off_m for off_m, _ in moves.values()) < 0.006


def test_a_sensor_beside_the_road_is_no_part_of_the_vehicle(tmp_path: Path) -> None:
    folder = render_tiny(tmp_path / "out", aside=True)
    messages, _ = decoded(write_run("mcap", folder))
    ((_, mounts),) = messages["/tf_static"]
    assert [one.child_frame_id for one in mounts.transforms] == ["top"]
    tree = tree_of(messages)
    for time_ns, _ in messages["/camera/front/image"]:
        np.testing.assert_allclose(tree.in_world("front", time_ns)[:3, 3], [3.0, 8.0, 5.0], rtol=0, atol=1e-9)


def test_boxes_are_the_labels(folder: Path, messages: Messages) -> None:
    counts = []
    for labels, (_, update) in zip(labels_of(folder), messages["/boxes"], strict=True):
        assert len(update.deletions) == 1 and update.deletions[0].type == 1, "boxes that are gone are deleted"
        entities = {entity.id: entity for entity in update.entities}
        counts.append(len(entities))
        assert list(entities) == [box["id"] for box in labels["boxes"]]
        for box in labels["boxes"]:
            entity = entities[box["id"]]
            (cube,) = entity.cubes
            assert xyz(cube.pose.position) == box["world"]["position"]
            assert wxyz(cube.pose.orientation) == box["world"]["quaternion_wxyz"]
            assert xyz(cube.size) == box["size_m"] and entity.frame_id == "world"
            notes = {pair.key: pair.value for pair in entity.metadata}
            assert notes["class"] == box["class"] and json.loads(notes["velocity_m_s"]) == box["velocity_m_s"]
    assert counts == [2, 2, 1]


def test_calibration_projects_as_the_camera(folder: Path, messages: Messages) -> None:
    import cv2

    model = FinishedRun(folder).drive.cameras["front"].model
    point = np.array([[1.0, -0.5, 7.0]])
    for _, found in messages["/camera/front/calibration"]:
        assert (found.width, found.height, found.distortion_model) == (32, 18, "plumb_bob")
        matrix, rotation = np.array(found.K).reshape(3, 3), np.zeros(3)
        pixel, _ = cv2.projectPoints(point, rotation, rotation, matrix, np.array(found.D))
        u, v, _ = model.project(point)
        np.testing.assert_allclose(pixel[0, 0] + 0.5, [u[0], v[0]], atol=1e-9)
        assert list(found.P) == [*found.K[:3], 0, *found.K[3:6], 0, *found.K[6:], 0]


def test_rollout_is_its_steps(messages: Messages) -> None:
    for step, (time_ns, state) in zip(STEPS, messages["/ego/state"], strict=True):
        assert time_ns == step.time_us * 1000 and state.linear_velocity.x == step.ego.speed_m_s
        assert (state.pose.position.x, state.pose.position.y) == (step.ego.x_m, step.ego.y_m)
        yaw = 2 * np.arctan2(state.pose.orientation.z, state.pose.orientation.w)
        assert yaw == pytest.approx(step.ego.heading_rad)
        notes = {pair.key: float(pair.value) for pair in state.metadata}
        assert notes == {"acceleration_m_s2": step.ego.acceleration_m_s2, "steering_rad": step.ego.steering_rad}
    ((time_ns, plan),) = messages["/ego/plan"]
    assert time_ns == 0 and plan.frame_id == "world", "at the moment that the plan answered"
    np.testing.assert_array_equal(
        [[one.position.x, one.position.y] for one in plan.poses], np.stack([PLAN.x_m, PLAN.y_m], -1)
    )
    yaws = [2 * np.arctan2(one.orientation.z, one.orientation.w) for one in plan.poses]
    np.testing.assert_allclose(yaws, PLAN.heading_rad)


def test_written_twice_is_the_same_bytes(folder: Path, messages: Messages) -> None:
    first = (folder / "run.mcap").read_bytes()
    time.sleep(0.01)
    assert write_run("mcap", folder).read_bytes() == first


def test_times_before_the_first_frame_are_shifted(tmp_path: Path) -> None:
    found, metadata = decoded(write_run("mcap", render_tiny(tmp_path / "out", earlier_s=0.05)))
    assert metadata["shift_ns"] == "1000000000" and metadata["drive"] == "tiny"
    assert [time_ns for time_ns, _ in found["/camera/front/image"]] == [950_000_000, 1_050_000_000, 1_250_000_000]
    assert [time_ns for time_ns, _ in found["/boxes"]] == [1_000_000_000, 1_100_000_000, 1_300_000_000]
    assert json.loads(metadata["cameras"])["front"]["fx"] == 30 and "/ego/state" not in found


def test_captures_are_read_one_by_one(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However long a run is, one capture's files are in memory at a time."""
    opened: list[str] = []
    load = np.load

    def watched(path: Any, *more: Any, **others: Any) -> Any:
        opened.append(Path(path).stem)
        return load(path, *more, **others)

    monkeypatch.setattr(np, "load", watched)
    seen = [len(opened) for message in FinishedRun(folder).messages() if type(message).__name__ == "SweepMessage"]
    assert seen == [1, 2, 3] and opened == [f"{frame:06d}" for frame in FRAMES]


def test_a_missing_file_is_named_and_nothing_is_left(tmp_path: Path) -> None:
    out = render_tiny(tmp_path / "out")
    (out / "camera/front/000001.png").unlink()
    before = all_files(out)
    for name in ("mcap", "rosbag", "coco"):
        pytest.importorskip({"mcap": "mcap", "rosbag": "rosbags", "coco": "numpy"}[name])
        with pytest.raises(OutputError, match="000001.png: is missing"):
            write_run(name, out)
    assert all_files(out) == before
    with pytest.raises(OutputError, match="line 1 is no step"):
        (out / "steps.jsonl").write_text("{}\n")
        write_run("mcap", out)


def test_what_frames_lack_is_said() -> None:
    settings = SequenceSettings(("front",), ("top",), formats=("png", "npz"))
    with pytest.raises(OutputError, match=r"a.json: the format mcap is made of labels files"):
        check_formats(("pandaset", "mcap"), settings, Path("a.json"))
    images = SequenceSettings(("front",), (), formats=("png", "labels"))
    check_formats(("mcap", "coco"), images, Path("a.json"))
    with pytest.raises(OutputError, match="made of npz files"):
        check_formats(("mcap",), replace(images, lidars=("top",)), Path("a.json"))
