"""Edits against a truth that is known by hand, and against the street's."""

from __future__ import annotations

import numpy as np
import pytest
from tiny_drive import GreyRenderer, tiny_drive

from unisim_blender.core.evaluation.images import (
    CaptionedImage,
    depth_image,
    difference_image,
    outline,
    sheet,
    sweep_image,
    turbo,
)
from unisim_blender.core.evaluation.metrics import ImageArray
from unisim_blender.core.evaluation.recorded_runs import mean_metrics
from unisim_blender.core.evaluation.truth import EditRegions, edit_image_metrics, lidar_metrics_beside, summarise_truth
from unisim_blender.core.geometry import FloatArray
from unisim_street.demo import demo_frames


def grey(value: float) -> ImageArray:
    return np.full((12, 12, 3), value, np.float32)


def regions() -> EditRegions:
    """Rows 0 and 1 are edited, row 2 is shadow, the left half was seen."""
    row, column = np.indices((12, 12))
    return EditRegions(row < 2, row == 2, column < 6)


def test_regions_are_measured_apart() -> None:
    truth, rendered = grey(0.5), grey(0.5)
    rendered[:2] += 0.1
    rendered[2] += 0.2
    rendered[3:, 6:] += 0.01
    found = edit_image_metrics(rendered, truth, regions())
    error = {name: found[name]["mean_squared_error"] for name in regions().masks()}
    assert error["edited_without_shadow"] == pytest.approx(0.01, rel=1e-4)
    assert error["edited"] == pytest.approx((2 * 0.01 + 0.04) / 3, rel=1e-4)
    assert error["outside_edit"] == pytest.approx(1e-4 / 2, rel=1e-3)
    assert error["frame_without_shadow"] == pytest.approx((2 * 0.01 + 9 * 1e-4 / 2) / 11, rel=1e-3)
    assert error["frame_never_seen"] > error["frame_seen"]
    pixels = {name: found[name]["pixels"] for name in regions().masks()}
    assert pixels["edited"] == 36 and pixels["edited_seen"] == pixels["edited_never_seen"] == 18
    assert pixels["frame_seen"] + pixels["frame_never_seen"] == 144


def test_cost_of_an_edit_is_beside_the_replay() -> None:
    edit = edit_image_metrics(grey(0.5 + 0.1), grey(0.5), regions())
    replay = edit_image_metrics(grey(0.5 + 0.05), grey(0.5), regions())
    cost = summarise_truth([{"camera": {"front": {"edit": edit, "replay": replay}}, "lidar": {}}])["camera"][
        "edit_costs_db"
    ]
    assert cost["frame"] == pytest.approx(20 * np.log10(2), abs=1e-3)
    assert cost["edited"] == cost["edited_beside_whole_replay"] == pytest.approx(20 * np.log10(2), abs=1e-3)
    alone = summarise_truth([{"camera": {"new": {"edit": edit}}, "lidar": {}}])
    assert alone["camera"]["edit_costs_db"]["frame"] is None, "a camera that was never recorded has no replay"


def test_true_sweeps_are_rendered_ray_by_ray() -> None:
    renderer = GreyRenderer(tiny_drive())
    truth = renderer.lidar("top", 2)
    truth.depth_m = truth.depth_m + np.float32(0.2)
    blocked = np.zeros(truth.returned.shape, bool)
    blocked[0] = True
    metrics, rendered, true = lidar_metrics_beside(renderer, truth, blocked)
    assert metrics["depth_median_m"] == pytest.approx(0.2, abs=1e-4)
    assert metrics["hit_rate"] == 1.0
    assert len(rendered.points) == truth.returned[1:].size and len(true.points) == truth.returned[1:].sum()


def test_mean_over_logs_leaves_out_what_is_missing() -> None:
    logs = [
        {"camera": {"psnr_db": 20.0, "actors": {"psnr_db": None}, "by_sensor": {"a": 1}}},
        {"camera": {"psnr_db": 30.0, "actors": {"psnr_db": 25.0}}},
    ]
    assert mean_metrics(logs) == {"camera": {"psnr_db": 25.0, "actors": {"psnr_db": 25.0}}}


def test_demo_prefers_frames_that_were_not_trained_on() -> None:
    from tiny_drive import tiny_plan

    plan = tiny_plan()
    assert demo_frames(plan, (0, 2, 4), 2) == (1, 5)
    assert demo_frames(plan, (0, 2, 4), 3) == (1, 3, 5)
    assert demo_frames(plan, tuple(range(6)), 1) == (0,)


def test_images_of_numbers() -> None:
    depth = np.array([[2.0, 20.0, np.inf]], np.float32)
    image = depth_image(depth)
    assert image[0, 2].tolist() == [0, 0, 0] and image[0, 0, 0] > image[0, 1, 0], "near is red"
    assert difference_image(grey(0.5), grey(0.25)).min() == 255 and difference_image(grey(0.5), grey(0.5)).max() == 0
    assert turbo(np.array([0.5])).shape == (1, 3)
    points: FloatArray = np.array([[10.0, 0.0, 0.0], [0.0, 1000.0, 0.0]])
    above = sweep_image(points, np.ones(2), 100, 200, 0.2).astype(int)
    lit = np.argwhere(above.max(-1) > 50)
    assert lit.tolist() == [[50, 50]], "10 m ahead is 50 pixels above the middle, and what is outside is left out"
    mask = np.zeros((12, 12), bool)
    mask[3:8, 3:8] = True
    marked = (outline(np.zeros((12, 12, 3), np.uint8), mask) > 0).any(-1)
    assert marked.sum() == 16
    tiles = [
        [CaptionedImage("a", np.zeros((10, 20, 3), np.uint8)), CaptionedImage("b", np.zeros((10, 30, 3), np.uint8))],
        [CaptionedImage("c", above.astype(np.uint8))],
    ]
    assert sheet(tiles).shape[1] >= 100 + 30
