"""Runs as COCO's annotations, read by COCO's own tools."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_run import FRAMES, all_files, labels_of, render_tiny
from PIL import Image

from unisim_blender.core.export.finished_run import FinishedRun
from unisim_blender.core.export.formats import RUN_FORMATS, write_run
from unisim_blender.core.formats.common.messages import OpenCVCalibration, calibration_of
from unisim_blender.core.geometry import box_corners, make_pose
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole
from unisim_blender.core.scenario.types import DEFS, FRAME_FORMATS, SEQUENCE_FORMATS
from unisim_blender.core.sensors.silhouettes import box_bounds
from unisim_blender.core.world.drive import CameraModel

CAMERA = CameraModel(32, 18, 30.0, 30.0, 16.0, 9.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return render_tiny(tmp_path_factory.mktemp("coco") / "out")


def test_boxes_are_the_projected_labels(folder: Path) -> None:
    document = json.loads(write_run("coco", folder).read_text())
    model = FinishedRun(folder).drive.cameras["front"].model
    names = {one["id"]: one["name"] for one in document["categories"]}
    assert names == {1: "Car", 2: "Cones"}
    assert [image["time_s"] for image in document["images"]] == [frame / 10 for frame in FRAMES]
    wanted = []
    for image, labels in zip(document["images"], labels_of(folder), strict=True):
        with Image.open(folder / image["file_name"]) as pixels:
            assert pixels.size == (image["width"], image["height"])
        sizes = {box["id"]: (box["class"], np.array(box["size_m"])) for box in labels["boxes"]}
        for uid, pose in labels["sensors"]["front"]["boxes"].items():
            kind, size = sizes[uid]
            corners = box_corners(make_pose(np.array(pose["position"]), np.array(pose["quaternion_wxyz"])), size)
            u, v, _ = model.project(corners)
            left, right, top, bottom = max(u.min(), 0), min(u.max(), 32), max(v.min(), 0), min(v.max(), 18)
            if right - left >= 1 and bottom - top >= 1:
                wanted.append((image["id"], kind, uid, [left, top, right - left, bottom - top]))
    found = [(one["image_id"], names[one["category_id"]], one["actor"], one["bbox"]) for one in document["annotations"]]
    assert [one[:3] for one in found] == [one[:3] for one in wanted] and len(found) == 5
    np.testing.assert_allclose([one[3] for one in found], [one[3] for one in wanted], atol=1e-9)


def test_cocos_tools_read_it(folder: Path) -> None:
    coco = pytest.importorskip("pycocotools.coco", reason="pycocotools is not installed")
    from pycocotools.cocoeval import COCOeval

    truth = coco.COCO(str(write_run("coco", folder)))
    assert sorted(truth.imgs) == [1, 2, 3] and [one["name"] for one in truth.loadCats(truth.getCatIds())] == [
        "Car",
        "Cones",
    ]
    told: list[dict[str, Any]] = [
        {name: one[name] for name in ("image_id", "category_id", "bbox")} | {"score": 0.9}
        for one in truth.anns.values()
    ]
    score = COCOeval(truth, truth.loadRes(told), "bbox")
    score.evaluate()
    score.accumulate()
    score.summarize()
    assert score.stats[0] == pytest.approx(1.0), "the boxes themselves are a perfect detection"


def test_written_twice_is_the_same_bytes(folder: Path) -> None:
    first = all_files(write_run("coco", folder))
    assert all_files(write_run("coco", folder)) == first


def test_a_box_that_reaches_behind_the_camera_has_bounds_that_hold_it() -> None:
    model = CAMERA
    size = np.array([4.0, 2.0, 2.0])
    turned = make_pose(np.array([1.5, 0.0, 1.0]), np.array([0.5, 0.5, -0.5, 0.5]))
    bounds = box_bounds(model, turned, size)
    assert bounds is not None and bounds.right > model.width and bounds.left < model.width
    away = make_pose(np.array([0.0, 0.0, -9.0]), np.array([1.0, 0, 0, 0]))
    assert box_bounds(model, away, size) is None


def test_lenses_have_their_names() -> None:
    model = CAMERA
    matrix = (30.0, 0.0, 15.5, 0.0, 30.0, 8.5, 0.0, 0.0, 1.0)
    bent = {
        OpenCVPinhole(k1=0.1, k2=0.2, p1=0.01, p2=0.02, k3=0.03): ("plumb_bob", (0.1, 0.2, 0.01, 0.02, 0.03)),
        OpenCVPinhole(k1=0.1, k6=0.5): ("rational_polynomial", (0.1, 0, 0, 0, 0, 0, 0, 0.5)),
        OpenCVPinhole(k1=0.1, s1=0.5): ("opencv_pinhole", ()),
        OpenCVFisheye(0.01, 0.02, 0.003, 0.0004): ("equidistant", (0.01, 0.02, 0.003, 0.0004)),
    }
    for lens, (name, coefficients) in bent.items():
        assert calibration_of(replace(model, lens=lens)) == OpenCVCalibration(matrix, name, coefficients)
    assert calibration_of(model) == OpenCVCalibration(matrix, "plumb_bob", (0.0,) * 5)


def test_scenarios_know_the_formats() -> None:
    formats = DEFS["outputs"]["properties"]["formats"]["items"]["enum"]
    assert formats == [*FRAME_FORMATS, *SEQUENCE_FORMATS] and set(RUN_FORMATS) <= set(SEQUENCE_FORMATS)


def test_the_first_image_has_boxes(tmp_path: Path) -> None:
    """An image that is taken before the first frame's time shows who is there at that frame."""
    out = render_tiny(tmp_path / "out", 0.06)
    for labels in labels_of(out):
        named = {box["id"] for box in labels["boxes"]}
        assert named and set(labels["sensors"]["front"]["boxes"]) == named
    document = json.loads(write_run("coco", out).read_text())
    images = {one["image_id"] for one in document["annotations"]}
    assert images == {image["id"] for image in document["images"]}
