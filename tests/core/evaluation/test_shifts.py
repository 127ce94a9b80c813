"""The shift curve: labels of images, recall at a score with intervals over actors, and the command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from unisim_blender.core.cli.main import run, unisim
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.evaluation.shift_recall import (
    Detections,
    LabelledFrame,
    Recall,
    label_image,
    label_sweep,
    lost_per_metre,
    returns_of,
)
from unisim_blender.core.formats.readers import open_log
from unisim_street.street import build_street
from unisim_street.truth import truth_camera
from unisim_street.write import write_log

DETECTOR = '''
import numpy as np
from scipy import ndimage


class Orange:
    """Finds what is orange: cones, most of all."""

    classes = {"cone": ("Cones",)}

    def in_image(self, rgb):
        pixels = rgb.astype(float)
        orange = ndimage.binary_dilation(pixels[..., 0] - pixels[..., 2] > 60, iterations=2)
        parts = ndimage.find_objects(ndimage.label(orange)[0])
        boxes = np.array([(x.start + 2, y.start + 2, x.stop - 2, y.stop - 2) for y, x in parts], float).reshape(-1, 4)
        sizes = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
        return boxes[sizes > 8], 1 / sizes[sizes > 8], ["cone"] * int((sizes > 8).sum())


def detector():
    return Orange()
'''


def _labels(*uids: str, ignored: tuple[str, ...] = ()) -> LabelledFrame:
    boxes = np.array([[10.0 * i, 0, 10 * i + 8, 8] for i in range(len(uids))])
    return LabelledFrame(boxes, uids, ("Car",) * len(uids), np.array([uid in ignored for uid in uids]))


def _seen(labels: LabelledFrame, *scores: float | None) -> Detections:
    there = [i for i, score in enumerate(scores) if score is not None]
    return labels.boxes[there], np.array([scores[i] for i in there]), ["vehicle"] * len(there)


def test_recall_by_hand() -> None:
    labels = _labels("a", "b", "c", ignored=("c",))
    recorded, shifted = Recall(), Recall()
    recorded.add(("front", 0), labels, _seen(labels, 0.9, 0.8, 0.7), "vehicle", "image", ("Car",))
    nothing_there = np.array([[90.0, 90, 99, 99]]), np.array([0.3]), ["vehicle"]
    recorded.add(("front", 1), labels, nothing_there, "vehicle", "image", ("Car",))
    assert recorded.false_alarms == {("front", 0): [], ("front", 1): [0.3]}, "a detection of what is ignored is none"
    assert recorded.scores == {(("front", 0), "a"): 0.9, (("front", 0), "b"): 0.8} | {
        (("front", 1), uid): -np.inf for uid in "ab"
    }
    # all that is better than 0.8: two of four labels, no false alarm; F1 falls with the one of 0.3
    assert recorded.least_score() == 0.8
    shifted.add(("front", 0), labels, _seen(labels, 0.85, 0.5), "vehicle", "image", ("Car",))
    metrics = shifted.metrics(recorded.least_score(), recorded)
    assert metrics["recall"]["value"] == 0.5 and metrics["lost"]["value"] == 0.5 and metrics["lost"]["labels"] == 2
    assert metrics["false_alarms"] == 0
    shifted.add(("front", 1), labels, _seen(labels, 0.95, None), "cone", "image", ("Cones",))
    assert shifted.metrics(0.8, recorded)["recall"]["value"] == 0.5, "another class"


def test_intervals_are_of_actors_and_not_of_frames() -> None:
    few, many = Recall(), Recall()
    for frame in range(40):
        labels = _labels("a", "b")
        few.add(("front", frame), labels, _seen(labels, 0.9, None), "vehicle", "image", ("Car",))
        labels = _labels(*(f"{frame}-{i}" for i in range(2)))
        many.add(("front", frame), labels, _seen(labels, 0.9, None), "vehicle", "image", ("Car",))
    assert few.metrics(0.5, few)["recall"] == {"value": 0.5, "interval": [0.0, 1.0]}
    low, high = many.metrics(0.5, many)["recall"]["interval"]
    assert 0.35 < low < 0.45 and 0.55 < high < 0.65


def test_loss_per_metre_is_the_slope() -> None:
    """Of each of twenty actors a twentieth of the frames more is lost for each metre: none of the recorded ones is."""
    labels, row = _labels(*(f"car-{i}" for i in range(20))), {}
    recorded = Recall()
    for shift in (-3.0, -1.0, 0.0, 2.0):
        row[shift] = Recall()
        for frame in range(20):
            lost = 1 + abs(shift)
            seen = [None if (frame + i) % 20 < lost else 0.9 for i in range(20)]
            row[shift].add(("front", frame), labels, _seen(labels, *seen), "vehicle", "image", ("Car",))
            recorded.add(("front", frame), labels, _seen(labels, *[0.9] * 20), "vehicle", "image", ("Car",))
    slope = lost_per_metre(row, 0.5, recorded)
    assert slope["value"] == pytest.approx(0.05) and slope["interval"] == pytest.approx([0.05, 0.05])
    x, y = np.repeat(np.abs(list(row)), 400), []
    row[2.0].scores = {key: 0.9 if key[1] < "car-15" else -np.inf for key in row[2.0].scores}
    for recall in row.values():
        y += [1.0 - (score > 0.5) for score in recall.scores.values()]
    slope = lost_per_metre(row, 0.5, recorded)
    assert slope["value"] == pytest.approx(np.polyfit(x, y, 1)[0]), "least squares over labels"
    assert slope["interval"][0] < slope["value"] - 0.01 and slope["interval"][1] > slope["value"] + 0.01
    assert lost_per_metre({0.0: row[0.0]}, 0.5, recorded)["value"] is None


def test_labels_of_an_image_are_where_its_actors_are(tmp_path: Path) -> None:
    street = build_street(4, 3, 160, 90)
    write_log(street, tmp_path, 1, progress=False)
    log = open_log(tmp_path)
    returns = returns_of(log, ("pandar64",), 1)
    camera = log.drive.cameras["front_camera"]
    labels = label_image(log.drive, camera, 1, returns)
    frame = truth_camera(street, street.drive, "front_camera", 1)
    assert frame.instance is not None
    counted = 0
    for uid, box, ignored in zip(labels.uids, labels.boxes, labels.ignored, strict=True):
        v, u = np.nonzero(frame.instance == frame.instances.index(uid) + 1)
        if len(u) == 0:
            continue
        assert (
            u.min() >= box[0] - 1.5
            and u.max() + 1 <= box[2] + 1.5
            and v.min() >= box[1] - 1.5
            and v.max() + 1 <= box[3] + 1.5
        )
        counted += not ignored
        if not ignored and box[2] < 159 and box[0] > 1 and box[3] < 89:
            assert len(u) > 0.15 * np.prod(box[2:] - box[:2])
    assert counted >= 4
    seen = {uid for uid, ignored in zip(labels.uids, labels.ignored, strict=True) if not ignored}
    assert all(returns[uid] >= 5 for uid in seen)
    swept = label_sweep(log.drive, 1, 0.1, returns)
    ahead = swept.boxes[swept.uids.index("car-01")]
    assert 12 < ahead[0] < 26 and abs(ahead[1]) < 1 and not swept.ignored[swept.uids.index("car-01")]
    assert swept.ignored[swept.uids.index("car-05")], "it follows behind"
    narrow = replace(camera, model=camera.model.resized(80))
    np.testing.assert_allclose(label_image(log.drive, narrow, 1, returns).boxes, labels.boxes / 2, atol=1e-6)


def test_the_command_measures_scene_surfels_and_truth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "saturated.py").write_text(DETECTOR)
    monkeypatch.chdir(tmp_path)
    log = tmp_path / "log"
    write_log(build_street(0, 4, 128, 72, kind="curve"), log, 1, progress=False)
    trained = ["--preset", "tiny", "--iterations", "2", "--frames", "::2", "--width", "64", "--quiet"]
    assert run(["train", str(log), "--out", str(tmp_path / "scene"), *trained]) == 0
    asked = [
        "eval",
        str(tmp_path / "scene"),
        str(log),
        "--shifts",
        "--width",
        "128",
        "--frames",
        "1::2",
        "--out",
        "out",
    ]
    for name in ("camera/front_camera/01.jpg", "lidar/03.pkl.gz"):
        moved = log / name
        moved = moved if moved.exists() else next(moved.parent.glob(moved.name.split(".")[0] + ".*"))
        moved.rename(moved.with_name("away"))
        (tmp_path / name.replace("/", "-")).write_text(str(moved))
    none = CliRunner().invoke(unisim, [*asked, "--detector", "saturated:detector"])
    assert isinstance(none.exception, UnisimError) and "to look at that was recorded" in str(none.exception)
    for name in ("camera/front_camera/01.jpg", "lidar/03.pkl.gz"):
        moved = Path((tmp_path / name.replace("/", "-")).read_text())
        moved.with_name("away").rename(moved)
    refused = CliRunner().invoke(unisim, asked)
    assert refused.exit_code == 2 and "--shifts, --detector" in refused.output
    refused = CliRunner().invoke(unisim, [*asked, "--detector", "saturated:missing"])
    assert isinstance(refused.exception, UnisimError) and "has no 'missing'; it has Orange, detector" in str(
        refused.exception
    )
    (tmp_path / "trams.py").write_text(DETECTOR.replace('"Cones"', '"Tram"'))
    refused = CliRunner().invoke(unisim, [*asked, "--detector", "trams:detector"])
    assert "its actors are of the classes Car, Cones," in str(refused.exception)
    assert str(refused.exception).endswith("--detector names Tram")
    result = CliRunner().invoke(
        unisim, [*asked, "--detector", "saturated:detector", "--beside", "surfel"], catch_exceptions=False
    )
    assert result.exit_code == 0, result.output
    (curve,) = json.loads((tmp_path / "out/shifts.json").read_text())["curves"].values()
    assert list(curve) == ["recorded", "scene", "surfel", "truth"]
    assert all(list(row) == ["-3", "-2", "-1", "+0", "+1", "+2", "+3"] for row in curve.values())
    for shift, at in curve["recorded"].items():
        assert {row[shift]["frames"] for row in curve.values()} == {at["frames"]}, "rows look at the same frames"
    recorded, truth = curve["recorded"]["+0"], curve["truth"]["+0"]
    assert recorded["labels"] == truth["labels"] >= 4 and recorded["recall"]["value"] > 0.3
    assert abs(truth["lost"]["value"]) < 0.3, "the true image at no shift is the recorded one, but for JPEG"
    assert recorded["recall"]["value"] > curve["scene"]["+0"]["recall"]["value"], "an untrained scene shows no cones"
    assert "cone: recall" in result.output and (tmp_path / "out/views.png").is_file()
