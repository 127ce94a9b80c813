"""Boxes in datasets' own formats are given to logs, and a log's boxes are written as annotated datasets."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[3] / "benchmarks"))

from layout_logs.recording import Size, make_recording, write_pandaset

from unisim_blender.core.cli.main import run
from unisim_blender.core.convert import convert, open_source
from unisim_blender.core.data.log import Log
from unisim_blender.core.errors import LogError
from unisim_blender.core.formats.argoverse2.files import COLUMNS
from unisim_blender.core.formats.boxes import open_boxes, with_boxes
from unisim_blender.core.formats.common.arrow import feather_bytes, read_feather
from unisim_blender.core.formats.common.class_names import class_name
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.formats.writers import writer_named
from unisim_blender.core.geometry import FloatArray, invert_pose
from unisim_blender.core.tracks.box_file import Track, read_boxes, write_boxes

LAYOUTS = ("argoverse2", "kitti", "kitti-tracking", "nuscenes", "pandaset")


@dataclass(frozen=True)
class Logs:
    """A log without boxes, its boxes in a file, and the log in several layouts, which was written with these boxes."""

    boxed: Path
    converted: dict[str, Path]


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Logs:
    folder = tmp_path_factory.mktemp("layouts")
    recording = make_recording(Size(frames=6, width=96, height=64))
    recording.draw()
    labelled = open_log(write_pandaset(recording, folder / "labelled"))
    (folder / "labelled").rename(folder / "bare")
    for file in (folder / "bare" / "annotations" / "cuboids").iterdir():
        file.unlink()
    bare = open_log(folder / "bare")
    assert not bare.drive.actors
    tracks = [Track(replace(actor, uid=f"own-{uid}")) for uid, actor in labelled.drive.actors.items()]
    write_boxes(folder / "bare.boxes.json", bare, tracks, "a test")
    converted = {}
    for layout in LAYOUTS:
        done = convert(open_source(folder / "bare.boxes.json"), writer_named(layout), folder / layout)
        converted[layout] = done.opens
    return Logs(folder / "bare.boxes.json", converted)


def in_camera(log: Log) -> dict[str, tuple[bool, FloatArray]]:
    """Whether actors move, and their places (3,) in the camera's frame as it takes its third image."""
    camera = next(camera for name, camera in log.drive.cameras.items() if len(log.image_frames(name)) > 3)
    time_s = camera.time_s[log.image_frames(camera.sensor_id)[2]]
    view = invert_pose(camera.world_from_camera.at(time_s))
    return {a.uid: (a.is_moving, (view @ a.world_from_actor.at(time_s))[:3, 3]) for a in log.drive.actors.values()}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_log_with_boxes_is_written_as_an_annotated_dataset(logs: Logs, layout: str) -> None:
    own, written = in_camera(open_log(logs.boxed)), in_camera(open_log(logs.converted[layout]))
    assert len(written) >= (4 if layout == "kitti-tracking" else 15)  # those that the camera sees
    # nuScenes has one key frame of these, so that nothing moves there
    places = [place for moves, place in written.values() if layout != "nuscenes" or not moves]
    known = np.array([place for moves, place in own.values() if layout != "nuscenes" or not moves])
    away = [float(np.linalg.norm(known - place, axis=1).min()) for place in places]
    assert np.median(away) < 0.02 and (layout == "nuscenes" or max(away) < 0.06)


def same_boxes(log: Path, boxes: Path) -> None:
    """Check that a log's boxes from a file are those that it has itself."""
    own, given = open_log(log).drive.actors, {track.actor.uid: track.actor for track in open_boxes(log, boxes).tracks}
    assert own.keys() == given.keys() and len(own) >= 4
    for uid, actor in own.items():
        np.testing.assert_allclose(given[uid].world_from_actor.poses, actor.world_from_actor.poses, atol=1e-9)
        np.testing.assert_allclose(given[uid].size_m, actor.size_m)
        assert given[uid].label == actor.label and given[uid].is_moving == actor.is_moving


def test_annotations_of_argoverse_2(logs: Logs, tmp_path: Path) -> None:
    log = logs.converted["argoverse2"]
    same_boxes(log, log / "annotations.feather")
    table = read_feather(log / "annotations.feather", COLUMNS)
    columns = {name: values.tolist() if values.dtype.kind in "UO" else values for name, values in table.items()}
    scored = {**columns, "score": np.full(len(table["category"]), 2.0)}
    (tmp_path / "tracks.feather").write_bytes(feather_bytes(scored))
    tracks = open_boxes(log, tmp_path / "tracks.feather").tracks
    assert tracks[0].certainty == pytest.approx(1 / (1 + np.exp(-2))) and tracks[0].source == "tracks.feather"
    assert len(open_log(with_boxes(log, tmp_path / "tracks.feather")).drive.actors) == len(tracks)
    detected = {name: values for name, values in scored.items() if name != "track_uuid"}
    (tmp_path / "detected.feather").write_bytes(feather_bytes(detected))
    with pytest.raises(LogError, match="detected.feather: has detections, which are of no track"):
        open_boxes(log, tmp_path / "detected.feather")
    late = {**columns, "timestamp_ns": table["timestamp_ns"] + 10**12}
    (tmp_path / "late.feather").write_bytes(feather_bytes(late))
    with pytest.raises(LogError, match=r"late.feather: its boxes are at 1000.0 to 1000.5 s of .*: of another drive"):
        open_boxes(log, tmp_path / "late.feather")
    with pytest.raises(LogError, match="is no Feather file"):
        open_boxes(log, logs.boxed.parent / "bare" / "lidar" / "poses.json")


def test_labels_of_kittis_tracking_benchmark(logs: Logs, tmp_path: Path) -> None:
    log = logs.converted["kitti-tracking"]
    (labels,) = logs.boxed.parent.glob("kitti-tracking/**/label_02/*.txt")
    same_boxes(log, labels)
    lines = [line for line in labels.read_text().splitlines() if "DontCare" not in line]
    scored = tmp_path / "tracker.txt"
    scored.write_text("\n".join(f"{line} 0.25" for line in lines))
    same_boxes(log, scored)
    assert {track.certainty for track in open_boxes(log, scored).tracks} == {0.25}
    for change, sentence in (
        (lambda words: [str(int(words[0]) + 900), *words[1:]], r"has frames 900 to 90\d, none of which"),
        (lambda words: words[:12], "line 1 is no label, it has 12 values"),
        (lambda words: [*words[:10], "-1", *words[11:]], "line 1 has the size"),
        (lambda words: [*words[:13], "nan", *words[14:]], "line 1 holds a number that is not finite"),
    ):
        scored.write_text("\n".join(" ".join(change(line.split())) for line in lines))
        with pytest.raises(LogError, match=sentence):
            open_boxes(log, scored)


def test_results_of_nuscenes_tracking_benchmark(logs: Logs, tmp_path: Path) -> None:
    log = logs.converted["nuscenes"]
    (tables,) = logs.boxed.parent.glob("nuscenes/v1.0-*")
    rows = {
        name: json.loads((tables / f"{name}.json").read_text())
        for name in ("sample_annotation", "instance", "category")
    }
    category = {row["token"]: row["name"] for row in rows["category"]}
    label = {row["token"]: category[row["category_token"]] for row in rows["instance"]}
    benchmark = "car truck bus trailer construction_vehicle motorcycle bicycle pedestrian traffic_cone barrier".split()
    short = {class_name(name, "nuscenes"): name for name in benchmark}
    assert len(short) == 10 and not set(short) & set(benchmark)
    results: dict[str, list[dict[str, object]]] = {"elsewhere": []}
    for row in rows["sample_annotation"]:
        name = label[row["instance_token"]]
        box = {key: row[key] for key in ("translation", "size", "rotation")}
        box |= {"tracking_id": row["instance_token"], "tracking_name": short.get(name, name), "tracking_score": 0.5}
        results.setdefault(row["sample_token"], []).append(box)
    path = tmp_path / "results.json"
    path.write_text(json.dumps({"meta": {}, "results": results}))
    same_boxes(log, path)
    assert {track.certainty for track in open_boxes(log, path).tracks} == {0.5}
    first = next(boxes for boxes in results.values() if boxes)
    first[0]["size"] = [1, -1, 1]
    path.write_text(json.dumps({"meta": {}, "results": results}))
    with pytest.raises(LogError, match=r"results.json: results\.\w+\[0\].size: must be above 0"):
        open_boxes(log, path)
    path.write_text(json.dumps({"meta": {}, "results": {"elsewhere": []}}))
    with pytest.raises(LogError, match=r"has none of the scene's \d samples"):
        open_boxes(log, path)


def test_a_file_that_no_layout_has(logs: Logs, tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text('{"boxes": []}')
    with pytest.raises(LogError, match="x.json: is no file of boxes, which begins with"):
        open_boxes(logs.boxed.parent / "bare", tmp_path / "x.json")
    with pytest.raises(LogError, match="there is no such file of boxes"):
        with_boxes(logs.boxed.parent / "bare", tmp_path / "y.json")


def test_track_writes_boxes_from_elsewhere_and_links_detections(logs: Logs, tmp_path: Path) -> None:
    log = logs.converted["argoverse2"]
    out = tmp_path / "out.boxes.json"
    assert run(["track", str(log), "--boxes", str(log / "annotations.feather"), "--out", str(out), "--quiet"]) == 0
    assert open_log(out).drive.actors.keys() == open_log(log).drive.actors.keys()
    table = read_feather(log / "annotations.feather", COLUMNS)
    detected = {name: values.tolist() if values.dtype.kind in "UO" else values for name, values in table.items()}
    del detected["track_uuid"]
    (tmp_path / "detected.feather").write_bytes(
        feather_bytes({**detected, "score": np.full(len(table["category"]), 0.6)})
    )
    args = ["track", str(log), "--boxes", str(tmp_path / "detected.feather"), "--out", str(out), "--quiet"]
    assert run([*args, "--poses", "log"]) == 0
    boxes = read_boxes(out)
    assert boxes.source == "unisim track and detected.feather" and len(boxes.tracks) >= 12
    assert any("detected.feather" in track.source and track.certainty >= 0.6 for track in boxes.tracks)
    assert run([*args, "--detector", "x"]) == 1
