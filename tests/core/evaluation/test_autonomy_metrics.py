"""Average precision, agreement, forecasts and plans against values worked out by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unisim_blender.core.cli.main import run
from unisim_blender.core.evaluation.autonomy.document import (
    FrameOutput,
    MetricsError,
    ModelOutputs,
    bev_iou,
    image_iou,
    read_outputs,
    without_duplicates,
    write_outputs,
)
from unisim_blender.core.evaluation.autonomy.measure import (
    Matches,
    average_precision,
    best_f1,
    collect,
    confident,
    end_point_error,
    interval,
    match,
    measure,
    min_ade,
    precision_recall,
    resampled_weights,
    weighted_average_precision,
)
from unisim_blender.core.geometry import FloatArray


def boxes(*rows: tuple[float, ...]) -> FloatArray:
    return np.array(rows, np.float64)


CAR = (10.0, 2.0, 4.0, 2.0, 0.0)


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (CAR, 1.0),
        ((10.0, 2.0, 4.0, 2.0, np.pi), 1.0),
        ((10.0, 2.0, 2.0, 4.0, np.pi / 2), 1.0),
        ((12.0, 2.0, 4.0, 2.0, 0.0), 1 / 3),
        ((14.0, 2.0, 4.0, 2.0, 0.0), 0.0),
        ((10.0, 2.0, 4.0, 2.0, np.pi / 2), 4 / 12),
        ((10.0, 2.0, 2.0, 1.0, 0.0), 0.25),
        ((99.0, 2.0, 4.0, 2.0, 0.0), 0.0),
    ],
    ids=["itself", "backwards", "turned sides", "half aside", "touching", "crossed", "inside", "far"],
)
def test_iou_from_above(other: tuple[float, ...], expected: float) -> None:
    assert bev_iou(boxes(CAR), boxes(other))[0, 0] == pytest.approx(expected, abs=1e-12)


def test_iou_of_a_square_and_the_same_turned_by_45_degrees() -> None:
    # they share a regular octagon of inradius 1: 8 tan(22.5 degrees)
    shared = 8 * np.tan(np.pi / 8)
    found = bev_iou(boxes((3.0, 4.0, 2.0, 2.0, 0.0)), boxes((3.0, 4.0, 2.0, 2.0, np.pi / 4)))[0, 0]
    assert found == pytest.approx(shared / (8 - shared), abs=1e-12)


def clipped_area(subject: FloatArray, clip: FloatArray) -> float:
    """Area of two convex polygons' intersection, one edge and one vertex after the other."""
    polygon = [tuple(p) for p in subject]
    for a, b in zip(clip, np.roll(clip, -1, 0), strict=True):

        def side(p: tuple[float, ...], a: FloatArray = a, b: FloatArray = b) -> float:
            return float((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]))

        out: list[tuple[float, ...]] = []
        for p, q in zip(polygon, polygon[1:] + polygon[:1], strict=True):
            if side(p) >= 0:
                out.append(p)
            if (side(p) >= 0) != (side(q) >= 0):
                t = side(p) / (side(p) - side(q))
                out.append((p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])))
        polygon = out
    pairs = zip(polygon, polygon[1:] + polygon[:1], strict=True)
    return abs(sum(p[0] * q[1] - p[1] * q[0] for p, q in pairs)) / 2


def test_iou_of_random_boxes_is_the_plain_clippings() -> None:
    from unisim_blender.core.evaluation.autonomy.document import bev_corners

    rng = np.random.default_rng(0)
    a, b = (
        np.concatenate([rng.uniform(-3, 3, (30, 2)), rng.uniform(0.5, 6, (30, 2)), rng.uniform(-7, 7, (30, 1))], 1)
        for _ in "ab"
    )
    found = bev_iou(a, b)
    assert (found > 0.02).mean() > 0.4
    for i, j in np.ndindex(30, 30):
        shared = clipped_area(bev_corners(a[i : i + 1])[0], bev_corners(b[j : j + 1])[0])
        union = a[i, 2] * a[i, 3] + b[j, 2] * b[j, 3] - shared
        assert found[i, j] == pytest.approx(shared / union, abs=1e-10)


def test_iou_of_no_boxes() -> None:
    assert bev_iou(np.zeros((0, 5)), boxes(CAR)).shape == (0, 1)
    assert bev_iou(boxes(CAR), np.zeros((0, 5))).shape == (1, 0)
    assert image_iou(np.zeros((0, 4)), boxes((0, 0, 1, 1))).shape == (0, 1)


def test_iou_in_the_image() -> None:
    found = image_iou(boxes((0, 0, 10, 10)), boxes((0, 0, 10, 10), (5, 0, 15, 10), (5, 5, 15, 15), (10, 0, 20, 10)))
    assert found[0] == pytest.approx([1.0, 1 / 3, 25 / 175, 0.0])


def test_duplicates_go() -> None:
    overlap = image_iou(*(2 * [boxes((0, 0, 10, 10), (1, 0, 11, 10), (5, 0, 15, 10), (40, 0, 50, 10))]))
    assert without_duplicates(overlap, np.array([0.5, 0.9, 0.8, 0.1]), 0.5) == [1, 2, 3]
    assert without_duplicates(overlap[:0, :0], np.zeros(0), 0.5) == []


def test_a_label_is_taken_once_and_by_the_best() -> None:
    iou = np.array([[0.6, 0.0], [0.8, 0.0], [0.55, 0.5]])
    none = np.zeros(2, bool)
    # the second takes label 0 first; the first is a duplicate; the third falls back on label 1
    assert match(iou, np.array([0.7, 0.9, 0.3]), none, 0.5).tolist() == [-1, 0, 1]
    # exactly at the threshold counts
    assert match(iou, np.array([0.7, 0.9, 0.3]), none, 0.51).tolist() == [-1, 0, -1]


def test_of_equal_scores_the_nearest_comes_first() -> None:
    iou = np.array([[0.5], [0.9]])
    assert match(iou, np.array([0.5, 0.5]), np.zeros(1, bool), 0.3).tolist() == [-1, 0]
    assert match(iou[::-1], np.array([0.5, 0.5]), np.zeros(1, bool), 0.3).tolist() == [0, -1]


def test_what_overlaps_an_ignored_label_alone_is_left_out() -> None:
    iou = np.array([[0.9, 0.0], [0.8, 0.0], [0.0, 0.0], [0.4, 0.6]])
    ignored = np.array([True, False])
    assert match(iou, np.array([0.9, 0.8, 0.7, 0.6]), ignored, 0.5).tolist() == [-2, -2, -1, 1]
    assert match(iou[:0], np.zeros(0), ignored, 0.5).tolist() == []
    assert match(np.zeros((2, 0)), np.array([0.9, 0.8]), np.zeros(0, bool), 0.5).tolist() == [-1, -1]


def matches(scores: list[float], hits: list[int], labels: int) -> Matches:
    return Matches(np.array(scores), np.array(hits, bool), np.zeros(len(scores), np.int64), np.array([float(labels)]))


def test_average_precision_of_four_detections() -> None:
    # precision 1, 1/2, 2/3, 2/4 at recall 1/4, 1/4, 2/4, 2/4: 1/4 at 1, 1/4 at 2/3
    found = matches([0.9, 0.8, 0.7, 0.6], [1, 0, 1, 0], 4)
    assert average_precision(found) == pytest.approx(1 / 4 + 1 / 4 * 2 / 3)
    _, precision, recall = precision_recall(found)
    assert precision == pytest.approx([1, 1 / 2, 2 / 3, 1 / 2]) and recall == pytest.approx(
        [1 / 4, 1 / 4, 1 / 2, 1 / 2]
    )


def test_average_precision_takes_the_precision_of_higher_recalls() -> None:
    # precision 0, 1/2, 2/3: every recall up to 1 is reached with 2/3
    assert average_precision(matches([0.9, 0.8, 0.7], [0, 1, 1], 2)) == pytest.approx(2 / 3)


def test_equal_scores_enter_together() -> None:
    # one hit and one miss at one score: precision 1/2, whichever stands first
    for hits in ([1, 0], [0, 1]):
        assert average_precision(matches([0.5, 0.5], hits, 1)) == pytest.approx(0.5)


def test_average_precision_at_its_ends() -> None:
    assert average_precision(matches([0.9, 0.8], [1, 1], 2)) == 1.0
    assert average_precision(matches([0.9], [0], 2)) == 0.0
    assert average_precision(matches([], [], 2)) == 0.0
    assert np.isnan(average_precision(matches([], [], 0)))
    assert np.isnan(average_precision(matches([0.9], [0], 0)))


def test_best_f1_of_three_detections() -> None:
    # P, R: 1, 1/3; 1/2, 1/3; 2/3, 2/3: F1 1/2, 2/5, 2/3
    assert best_f1(matches([0.9, 0.8, 0.7], [1, 0, 1], 3)) == pytest.approx((2 / 3, 0.7))
    assert best_f1(matches([0.9], [0], 3)) == (0.0, float("inf"))
    assert best_f1(matches([], [], 0)) == (0.0, float("inf"))


def test_resampled_frames_are_frames_repeated() -> None:
    rng = np.random.default_rng(3)
    frames = [(rng.random(5).round(1), np.where(rng.random(5) < 0.6, np.arange(5), -1), 6) for _ in range(4)]
    together = collect(frames, [0, 1, 2, 3])
    for counts in ([1, 1, 1, 1], [2, 0, 1, 1], [0, 0, 0, 4]):
        repeated = [frame for frame, count in zip(frames, counts, strict=True) for _ in range(count)]
        plain = average_precision(collect(repeated, range(4)))
        assert weighted_average_precision(together, np.array([counts], float))[0] == pytest.approx(plain)
    assert np.isnan(weighted_average_precision(together, np.zeros((1, 4)))[0])


def test_resamples_draw_as_many_units_as_there_are() -> None:
    weights = resampled_weights(5, 200, seed=1)
    assert weights.shape == (200, 5) and (weights.sum(1) == 5).all()
    assert weights.mean() == 1 and weights.std() == pytest.approx(np.sqrt(4 / 5), rel=0.1)
    assert (resampled_weights(5, 200, seed=1) == weights).all()


def test_interval_of_a_hundred_and_one_values() -> None:
    assert interval(np.arange(101.0)) == pytest.approx((2.5, 97.5))
    assert interval(np.array([np.nan, 1.0])) == (1.0, 1.0)
    assert np.isnan(interval(np.array([np.nan]))).all()


def test_min_ade_of_two_modes() -> None:
    truth = boxes((1, 0), (2, 0), (3, 0))
    aside, off = truth + [0, 1], truth + boxes((0, 0), (0, 0), (3, 4))
    assert min_ade(np.stack([aside, off]), np.array([0.5, 0.5]), truth) == pytest.approx(1.0)
    # where the truth ends, so does the comparison
    assert min_ade(np.stack([aside, off]), np.array([0.5, 0.5]), truth[:2]) == pytest.approx(0.0)


def test_min_ade_takes_the_six_most_probable_modes() -> None:
    truth = np.zeros((4, 2))
    modes = np.stack([truth + [0, 1 + k] for k in range(8)])
    assert min_ade(modes, np.arange(8.0), truth) == pytest.approx(3.0)


def test_end_point_error_is_of_the_last_positions() -> None:
    assert end_point_error(boxes((9, 9), (3, 0)), boxes((0, 0), (0, 4))) == pytest.approx(5.0)


def output(
    rows: list[tuple[float, ...]], scores: list[float], ignored: list[bool] | None = None, **more: Any
) -> FrameOutput:
    names = tuple(["car"] * len(rows))
    flags = np.array(ignored or [False] * len(rows), bool)
    return FrameOutput(np.array(rows, np.float64).reshape(-1, 5), np.array(scores), names, flags, **more)


def aside(metres: float) -> tuple[float, ...]:
    return (CAR[0], CAR[1] + metres, *CAR[2:])


FAR = (30.0, -3.0, 4.0, 2.0, 0.0)
LABELS = ModelOutputs("bev", {("a", 0): output([CAR, FAR], [1.0, 1.0]), ("a", 1): output([CAR], [1.0])}, False)


def test_measure_of_two_frames() -> None:
    # 1/3 m aside of 2 m width: IoU (5/3) / (7/3) = 5/7; 1 m aside: 1/3
    found = ModelOutputs(
        "bev", {("a", 0): output([aside(1 / 3), (60, 0, 4, 2, 0)], [0.9, 0.8]), ("a", 1): output([aside(1.0)], [0.7])}
    )
    car = measure(found, LABELS, resamples=50)["classes"]["car"]
    # at 0.1 and 0.3: hit, miss, hit of three labels; above 1/3 one hit alone; above 5/7 none
    both, one = 1 / 3 + 1 / 3 * 2 / 3, 1 / 3
    values = {name: car[name]["value"] for name in ("ap@0.1", "ap@0.3", "ap@0.5", "ap@0.7", "ap@0.8", "map")}
    expected = {
        "ap@0.1": both,
        "ap@0.3": both,
        "ap@0.5": one,
        "ap@0.7": one,
        "ap@0.8": 0.0,
        "map": (2 * both + 2 * one) / 5,
    }
    assert values == pytest.approx(expected)
    assert car["labels"] == 3 and car["detections"] == 3
    low, high = car["ap@0.5"]["interval"]
    # of two frames, both may be drawn from either: AP 1/2 or 0
    assert low == 0.0 and high == pytest.approx(0.5)


def test_units_are_sequences_where_there_are_several() -> None:
    perfect = output([CAR], [0.9])
    label = output([CAR], [1.0])
    labels = ModelOutputs("bev", {("a", 0): label, ("a", 1): label, ("b", 0): label}, False)
    found = ModelOutputs("bev", {("a", 0): perfect, ("a", 1): perfect, ("b", 0): output([], [], None)}, True)
    metrics = measure(found, labels, resamples=200)
    assert metrics["resampled"] == 2
    assert metrics["classes"]["car"]["ap@0.5"] == {"value": pytest.approx(2 / 3), "interval": [0.0, 1.0]}


def test_a_class_is_matched_with_itself_alone() -> None:
    frame = output([CAR], [0.9])
    other = FrameOutput(frame.boxes, frame.scores, ("bus",), frame.ignored)
    metrics = measure(
        ModelOutputs("bev", {("a", 0): other}), ModelOutputs("bev", {("a", 0): frame}, False), resamples=5
    )
    assert metrics["classes"]["car"]["ap@0.1"]["value"] == 0.0 and "bus" not in metrics["classes"]


def test_agreement_with_detections_on_other_data() -> None:
    real = ModelOutputs("bev", {("a", 0): output([CAR, FAR], [0.9, 0.2])})
    assert measure(real, confident(real, 0.1), (0.3,), 5)["classes"]["car"]["ap@0.3"]["value"] == 1.0
    # below the least score FAR is no label, and finding it is a false positive; the better CAR comes first
    assert measure(real, confident(real, 0.5), (0.3,), 5)["classes"]["car"]["labels"] == 1
    nothing = ModelOutputs("bev", {("a", 0): output([], [])})
    assert measure(nothing, confident(real, 0.1), (0.3,), 5)["classes"]["car"]["ap@0.3"]["value"] == 0.0
    with pytest.raises(MetricsError, match="no score"):
        confident(LABELS, 0.5)


def box_document(**more: Any) -> dict[str, Any]:
    return {"box": list(CAR), "class": "car", "score": 0.9, **more}


def document(*frames: dict[str, Any]) -> dict[str, Any]:
    return {"format": "unisim-autonomy", "version": 1, "boxes": "bev", "frames": list(frames)}


def write(path: Path, content: dict[str, Any]) -> Path:
    path.write_text(json.dumps(content))
    return path


def test_forecasts_and_plans_of_two_documents(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    straight, left = [[1.0, 0.0], [2.0, 0.0]], [[1.0, 1.0], [2.0, 2.0]]
    modes = [{"probability": 0.3, "positions": left}, {"probability": 0.7, "positions": straight}]
    real = document({"frame": 0, "boxes": [box_document(modes=modes)], "plan": [[5, 0], [9, 0]]})
    near = [[1.0, 0.5], [2.0, 0.5]]
    simulated = document({"frame": 0, "boxes": [box_document(modes=[{"positions": near}])], "plan": [[5, 0], [9, 2]]})
    paths = [write(tmp_path / "sim.json", simulated), write(tmp_path / "real.json", real)]
    out = tmp_path / "figures.json"
    assert run(["metrics", *map(str, paths), "--agreement", "--resamples", "5", "--out", str(out)]) == 0
    metrics = json.loads(out.read_text())
    forecast = metrics["classes"]["car"]["forecasts"]
    # the label is the most probable mode, straight on: 0.5 m at either step
    assert forecast == {"min_ade_m": 0.5, "actors": 1, "f1": 1.0, "least_score": 0.9}
    assert metrics["plans"] == {"end_point_error_m": 2.0, "frames": 1}
    printed = capsys.readouterr().out
    assert "AP@0.3    100.0   100.0 … 100.0" in printed and "end-point error 2.000 m" in printed


def test_a_document_is_read_as_it_was_written(tmp_path: Path) -> None:
    frame = output([CAR, FAR], [0.25, 0.5], [False, True], plan=boxes((1, 2), (3, 4)))
    write_outputs(tmp_path / "o.json", ModelOutputs("bev", {("a", 3): frame}))
    found = read_outputs(tmp_path / "o.json")
    back = found.frames[("a", 3)]
    assert (back.boxes == frame.boxes).all() and (back.scores == frame.scores).all() and back.classes == frame.classes
    assert (back.ignored == frame.ignored).all() and found.scored
    assert back.plan is not None and back.plan.tolist() == [[1, 2], [3, 4]]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"format": "coco"}, 'format: must be "unisim-autonomy", not .coco'),
        ({"version": 2}, "has version 2, newer than the 1"),
        ({"boxes": "cube"}, "boxes: must be one of bev, image"),
        ({"frames": [{"frame": 0}]}, r'frames\[0\]: "boxes" is missing'),
        ({"frames": [{"frame": 0, "boxes": []}, {"frame": 0, "boxes": []}]}, r"frames\[1\]: frame 0 is there twice"),
        ({"frames": [{"frame": 0, "boxes": [{"box": [1, 2, 3, 4]}]}]}, r"boxes\[0\].box: must be 5 numbers"),
        (
            {"frames": [{"frame": 0, "boxes": [{"box": [1, 2, 0, 4, 0]}]}]},
            r"boxes\[0\].box: length and width must be above 0",
        ),
        ({"frames": [{"frame": 0, "boxes": [box_document(score="x")]}]}, "score: must be a finite number"),
        ({"frames": [{"frame": 0, "boxes": [box_document(scor=1)]}]}, "'scor' is none of"),
        ({"frames": [{"frame": 0, "boxes": [], "plan": []}]}, "plan: has no position"),
        ({"frames": [{"frame": 0, "boxes": [box_document(modes=[])]}]}, "modes: has no mode"),
    ],
)
def test_a_bad_document_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict[str, Any], sentence: str
) -> None:
    good = write(tmp_path / "good.json", document({"frame": 0, "boxes": [box_document()]}))
    bad = write(tmp_path / "bad.json", {**document(), **change})
    with pytest.raises(MetricsError, match=sentence) as caught:
        read_outputs(bad)
    assert str(bad) in str(caught.value)
    assert run(["metrics", str(bad), str(good)]) == 1
    assert capsys.readouterr().err == f"Error: {caught.value}\n"


def test_frames_may_be_times(tmp_path: Path) -> None:
    one = FrameOutput(boxes(CAR), np.array([0.9]), ("vehicle",), np.zeros(1, bool))
    given = ModelOutputs("bev", {("", "t0000001050000us"): one, ("", 3): one}, True, tmp_path / "out.json")
    write_outputs(given.path, given)
    again = read_outputs(given.path)
    assert list(again.frames) == [("", "t0000001050000us"), ("", 3)]
    labels = ModelOutputs("bev", {("", "t0000001050000us"): one}, True, tmp_path / "labels.json")
    with pytest.raises(MetricsError, match="has no frame 3, which"):
        measure(again, labels, None, 10, 0)


def test_documents_that_do_not_belong_together() -> None:
    empty = output([], [])
    with pytest.raises(MetricsError, match="has no frame 1 of sequence 'a'"):
        measure(ModelOutputs("bev", {("a", 0): empty}), LABELS)
    with pytest.raises(MetricsError, match="boxes: are image"):
        measure(ModelOutputs("image", {}), LABELS)
    with pytest.raises(MetricsError, match="there is none"):
        measure(ModelOutputs("bev", {}), ModelOutputs("bev", {}))
    with pytest.raises(MetricsError, match="a detection has no score"):
        measure(LABELS, LABELS)
    short = output([CAR], [0.9], plan=boxes((1, 2)))
    with pytest.raises(MetricsError, match="plan has 1 positions"):
        measure(
            ModelOutputs("bev", {("", 0): short}),
            ModelOutputs("bev", {("", 0): output([CAR], [1.0], plan=boxes((1, 2), (3, 4)))}, False),
        )
