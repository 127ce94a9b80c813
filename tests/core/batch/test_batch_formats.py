"""Formats of whole variants in batches: the bytes that `unisim render` and `unisim drive` write of each alone."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from small_batch import batch, files, write_batch

from unisim_blender.core.batch.records import Store
from unisim_blender.core.cli.main import run

for module in ("mcap_protobuf", "rosbags"):
    pytest.importorskip(module, reason="the extras mcap and rosbag are not installed")

FORMATS = ("mcap", "rosbag", "coco", "pandaset", "video")
ASKED = tuple(word for name in FORMATS for word in ("--format", name))
RENDER = ("--renderer", "surfel", "--quality", "fast", "--jobs", "1")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, small_street: Path) -> Path:
    return write_batch(tmp_path_factory.mktemp("formats"), small_street, formats=["png", "npz", "labels"])


@pytest.fixture(scope="module")
def whole(folder: Path) -> Path:
    assert batch(folder / "sweep.json", folder / "whole", *ASKED) == 0
    return folder / "whole"


def manifest_of(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "manifest.json").read_bytes())
    return document


def test_a_variants_formats_are_what_rendering_it_alone_gives(folder: Path, whole: Path, tmp_path: Path) -> None:
    scenario = whole / "variants" / "cars-0001" / "scenario.json"
    asked = [word for name in FORMATS[:4] for word in ("--format", name)]
    assert run(["render", str(scenario), "--out", str(tmp_path / "alone"), *RENDER, *asked, "--video"]) == 0
    there, alone = files(scenario.parent), files(tmp_path / "alone")
    there.pop("scenario.json")
    coco = json.loads(there.pop("coco.json"))
    assert {name.split("/")[0] for name in there} == {"run.mcap", "rosbag", "pandaset", "camera"}
    assert [name for name in there if name.startswith("camera/")] == ["camera/front_camera.mp4"]
    assert {name: alone[name] for name in there} == there
    # images of the batch lie with its captures
    images = [scenario.parent / one["file_name"] for one in coco["images"]]
    assert [image.read_bytes() for image in images] == [
        alone[f"camera/front_camera/{frame:06d}.png"] for frame in range(3)
    ]
    for one in coco["images"]:
        one["file_name"] = one["file_name"].split("/", 5)[-1]
    assert coco == json.loads(alone["coco.json"])


def test_the_manifest_lists_them_and_resuming_mends_them(folder: Path, whole: Path, tmp_path: Path) -> None:
    manifest = manifest_of(whole)
    assert manifest["unfinished"] == [] and manifest["counts"]["units"] == 4
    for name, variant in manifest["variants"].items():
        there = {f"variants/{name}/{file}" for file in files(whole / "variants" / name)}
        assert set(variant["files"]) == there - {f"variants/{name}/scenario.json"}
        assert sorted(variant["formats"]) == sorted(FORMATS)
    again = folder / "again"
    shutil.copytree(whole, again)
    (again / "variants" / "cars-0000" / "run.mcap").write_bytes(b"damaged")
    (again / "formats" / "cars-0001.json").unlink()
    (again / "manifest.json").unlink()
    assert batch(folder / "sweep.json", again, *ASKED, "--resume") == 0
    assert files(again) == files(whole)
    assert batch(folder / "sweep.json", again, "--format", "mcap", "--resume") == 1, "it is another batch"


def test_every_message_of_a_variants_mcap_is_decoded_and_two_batches_write_the_same_bytes(
    folder: Path, whole: Path
) -> None:
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    assert batch(folder / "sweep.json", folder / "twice", "--format", "mcap") == 0
    for name, variant in manifest_of(whole)["variants"].items():
        path = whole / "variants" / name / "run.mcap"
        assert (folder / "twice" / "variants" / name / "run.mcap").read_bytes() == path.read_bytes()
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
            decoded = [(channel.topic, content) for _, channel, _, content in reader.iter_decoded_messages()]
            summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert len(decoded) == summary.statistics.message_count
        counts = Counter(topic for topic, _ in decoded)
        moments = variant["moments"]
        shots = {"/camera/front_camera/image", "/camera/front_camera/calibration", "/lidar/pandar64/points", "/boxes"}
        assert {topic: counts[topic] for topic in shots} == dict.fromkeys(shots, len(moments))
        assert counts.keys() == {*shots, "/tf", "/tf_static"}
        images = [content.data for topic, content in decoded if topic == "/camera/front_camera/image"]
        assert images == [image_of(whole, captures["camera/front_camera"]) for captures in moments.values()]
        boxes = [{one.id for one in content.entities} for topic, content in decoded if topic == "/boxes"]
        assert ["second" in ids for ids in boxes] == [False, False, True], "the second car is in the last frame alone"


def image_of(batch_folder: Path, identity: str) -> bytes:
    """The image of a capture of a batch."""
    (path,) = (batch_folder / "captures" / identity[:2] / identity).rglob("*.png")
    return path.read_bytes()


def test_a_damaged_capture_fails_its_variants_alone(
    folder: Path, whole: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    read = Store.read
    manifest = manifest_of(whole)
    last = manifest["variants"]["cars-0001"]["moments"]["000002"]["camera/front_camera"]
    broken = next(iter(manifest["captures"][last]["files"]))

    def reading(self: Any, name: str) -> bytes | None:
        return b"broken" if name == broken else read(self, name)

    monkeypatch.setattr(Store, "read", reading)
    assert batch(folder / "sweep.json", folder / "damaged", "--format", "mcap", "--json") == 1
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    (failure,) = report["failures"]
    assert failure["variant"] == "cars-0001" and "is not what was stored there" in failure["reason"]
    assert failure["command"].startswith("unisim render ") and "--format mcap" in failure["command"]
    assert manifest_of(folder / "damaged")["unfinished"] == ["formats/cars-0001"]
    assert not (folder / "damaged" / "variants" / "cars-0001" / "run.mcap").exists()
    assert (folder / "damaged" / "variants" / "cars-0000" / "run.mcap").exists()
    monkeypatch.undo()
    assert batch(folder / "sweep.json", folder / "damaged", "--format", "mcap", "--resume") == 0
    assert (folder / "damaged" / "variants" / "cars-0001" / "run.mcap").read_bytes() == (
        whole / "variants" / "cars-0001" / "run.mcap"
    ).read_bytes()
    assert not list((folder / "damaged" / "failures").glob("*"))


def test_rollouts_have_them_too(folder: Path, tmp_path: Path) -> None:
    line = {"name": "driven", "scenario": "base.json", "driver": "constant"}
    (folder / "rollouts.jsonl").write_text(json.dumps(line))
    asked = ("--format", "mcap", "--format", "coco", "--sensors", "front_camera")
    assert batch(folder / "rollouts.jsonl", folder / "rollouts", *asked) == 0
    scenario = folder / "rollouts" / "variants" / "driven" / "scenario.json"
    alone = ["drive", str(scenario), "--driver", "constant", "--out", str(tmp_path / "alone"), *RENDER[:4], *asked]
    assert run(alone) == 0
    there = files(folder / "rollouts" / "rollouts" / "driven")
    for name in ("run.mcap", "coco.json"):
        assert there[name] == (tmp_path / "alone" / name).read_bytes()
    made = manifest_of(folder / "rollouts")["variants"]["driven"]["rollout"]["files"]
    assert "rollouts/driven/run.mcap" in made


def test_what_cannot_be_written_is_told_before_anything_runs(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert batch(folder / "rollouts.jsonl", tmp_path / "out", "--format", "video") == 1
    assert "--format video: of rollouts there are mcap, rosbag, coco" in capsys.readouterr().err
    write_batch(tmp_path, folder / "street", formats=["exr", "labels", "video"])
    assert batch(tmp_path / "base.json", tmp_path / "out") == 1
    assert "base.json: the format video is made of png files" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
