"""Evaluation on a log whose errors are known, and the report it writes.

What a lens does not show of an image is not compared.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tiny_drive import GreyRenderer, TinyLog, log_with_captures_between, tiny_drive

from unisim_blender.core.data.log import Sweep
from unisim_blender.core.evaluation.recorded import EvaluationPlan, actor_mask, ego_speed, evaluate, finite
from unisim_blender.core.evaluation.recorded_runs import Report
from unisim_blender.core.geometry import FloatArray, invert_pose, transform_points
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.unprojection import image_mask
from unisim_blender.core.world.drive import CameraModel, LidarModel, RollingShutter

PLAN = EvaluationPlan((1, 3, 5), ("front",), ("top",), None, (0, 2, 4))


def test_figures_of_known_errors() -> None:
    log = TinyLog(offset=0.1)
    metrics = evaluate(GreyRenderer(log.drive), log, PLAN)
    json.dumps(metrics, allow_nan=False)
    level = [np.rint((0.4 + 0.01 * f**2) * 255) / 255 for f in range(6)]
    psnr = {f: -20 * np.log10(abs(0.5 - level[f])) for f in (1, 3, 5)}
    assert [record["camera"]["front"]["psnr_db"] for record in metrics["per_frame"]] == pytest.approx(
        list(psnr.values()), abs=1e-3
    )
    assert metrics["camera"]["psnr_db"] == pytest.approx(np.mean(list(psnr.values())), abs=1e-3)
    neighbours = [-20 * np.log10(abs((level[f - 1] + level[f + 1]) / 2 - level[f])) for f in (1, 3)]
    assert metrics["camera"]["neighbour_average_psnr_db"] == pytest.approx(np.mean(neighbours), abs=1e-3)
    assert metrics["per_frame"][2]["camera"]["front"]["neighbour_average_psnr_db"] is None, (
        "nothing was trained on after 5"
    )
    lidar = metrics["lidar"]
    assert lidar["sweeps"] == 2, "the last frame has no sweep"
    for name in ("depth_median_m", "depth_p90_m", "depth_mean_m"):
        assert lidar[name] == pytest.approx(0.1, abs=1e-4)
    assert lidar["hit_rate"] == 1.0
    assert lidar["intensity_rmse"] == pytest.approx(0.25, abs=1e-6)
    assert lidar["chamfer_m"] > 0
    grids = [log.sweep_grid("top", frame) for frame in (1, 3)]
    accuracy = np.mean([grid.returned[~grid.blocked].mean() for grid in grids])
    assert lidar["drop_accuracy"] == pytest.approx(accuracy), "every ray returns here, and blocked cells do not count"


def test_frames_are_split_by_speed() -> None:
    log = TinyLog()
    assert ego_speed(log.drive, log.drive.time_s[3]) == pytest.approx(5.0)
    still = replace(log.drive.world_from_ego, positions=log.drive.world_from_ego.positions * 0.01)
    log.drive = replace(log.drive, world_from_ego=still)
    metrics = evaluate(GreyRenderer(log.drive), log, PLAN)
    assert metrics["camera"]["driving"]["images"] == 0 and metrics["camera"]["driving"]["psnr_db"] is None
    assert metrics["camera"]["images"] == 3


class LevelRenderer(GreyRenderer):
    """LiDAR rays that all return from 20 m."""

    def rays_lidar(self, origins: FloatArray, directions: FloatArray, time_s: FloatArray) -> Any:
        one = np.ones(len(time_s), np.float32)
        return 20 * one, one * np.float32(0.25), one, np.zeros(len(time_s), np.int32)


def test_captures_between_frames_are_compared_too() -> None:
    """Those that belong to the frames, by their own numbers and times; beside them are the nearest that were trained on."""
    log = log_with_captures_between(offset=0.1)
    plan = replace(PLAN, frames=(1, 3))
    before = evaluate(LevelRenderer(log.drive), log, plan)
    metrics = evaluate(LevelRenderer(log.drive), log, replace(plan, between=True))
    assert [record["frame"] for record in metrics["per_frame"]] == [1, 3, 6]
    assert [[*record["camera"], *record["lidar"]] for record in metrics["per_frame"]] == [["front", "top"]] * 3
    assert metrics["camera"]["images"] == metrics["lidar"]["sweeps"] == 3 and before["camera"]["images"] == 2
    assert metrics["per_frame"][2]["ego_speed_m_s"] == pytest.approx(5.0)
    level = [np.rint((0.4 + 0.01 * f**2) * 255) / 255 for f in range(8)]
    for record, (one, other) in zip(metrics["per_frame"], ((0, 2), (2, 7), (2, 7)), strict=True):
        wanted = -20 * np.log10(abs((level[one] + level[other]) / 2 - level[record["frame"]]))
        assert record["camera"]["front"]["neighbour_average_psnr_db"] == pytest.approx(wanted, abs=1e-3)


def test_a_lidar_without_a_beam_table_is_measured_by_its_returns() -> None:
    log = TinyLog(offset=0.1)
    table = log.drive.lidars["top"]
    bare = replace(table, model=LidarModel(np.zeros(0), np.zeros(0), columns=1))
    grid = log.sweep_grid("top", 1)
    points = (grid.origins + grid.directions * 20.1)[grid.returned]
    none = np.full(len(points), -1, np.int32)
    sweep = Sweep(
        points, grid.origins[grid.returned], grid.time_s[grid.returned], grid.intensity[grid.returned], none, none, none
    )
    log.drive = replace(log.drive, lidars={"top": bare})
    log.sweep = lambda lidar, frame: sweep  # type: ignore[method-assign]
    log.sweep_grid = lambda lidar, frame: pytest.fail("it has none")  # type: ignore[method-assign]
    metrics = evaluate(LevelRenderer(log.drive), log, replace(PLAN, frames=(1,), cameras=()))
    assert metrics["lidar"]["sweeps"] == 1 and metrics["per_frame"][0]["lidar"]["top"]["rays"] == len(points)
    assert metrics["lidar"]["depth_median_m"] == pytest.approx(0.1, abs=1e-4)


def test_masked_figures_pool_pixels() -> None:
    log = TinyLog(offset=0.1)
    metrics = evaluate(GreyRenderer(log.drive), log, replace(PLAN, frames=(1, 3)))
    parts = [record["camera"]["front"]["actors"] for record in metrics["per_frame"]]
    assert all(part["pixels"] > 0 for part in parts)
    error = sum(p["mean_squared_error"] * p["pixels"] for p in parts) / sum(p["pixels"] for p in parts)
    assert metrics["camera"]["actors"]["psnr_db"] == pytest.approx(-10 * np.log10(error))
    inside, outside = (metrics["camera"][name]["pixels"] for name in ("actors", "outside_actors"))
    assert inside + outside == 2 * 18 * 32


def test_evaluation_at_another_width() -> None:
    log = TinyLog(offset=0.1)
    metrics = evaluate(GreyRenderer(log.drive), log, replace(PLAN, frames=(1,), width=16, lidars=()))
    assert metrics["camera"]["psnr_db"] == pytest.approx(-20 * np.log10(0.5 - np.rint(0.41 * 255) / 255), abs=1e-3)
    assert metrics["camera"]["actors"]["pixels"] + metrics["camera"]["outside_actors"]["pixels"] == 16 * 9
    assert metrics["lidar"]["depth_median_m"] is None


@pytest.mark.parametrize("duration", [0.0, 0.03])
def test_actor_mask_against_marching(duration: float) -> None:
    """A pixel is in the mask exactly where some point of its ray lies in the box, at the ray's own time."""
    drive = tiny_drive()
    camera = drive.cameras["front"]
    camera = replace(camera, model=replace(camera.model, shutter=RollingShutter(duration, 0.5)))
    car = drive.actors["car"]
    mask = actor_mask(camera, 2, [car])
    rays = camera_rays(camera, camera.time_s[2], *pixel_grid(camera.model))
    depths = np.arange(0.0, 30.0, 0.01)
    inside = np.zeros(mask.shape, bool)
    for row in range(mask.shape[0]):
        box_from_world = invert_pose(car.world_from_actor.at(rays.time_s[row, 0]))
        points = rays.origins[row, :, None] + rays.directions[row, :, None] * depths[:, None]
        local = transform_points(box_from_world, points)
        inside[row] = (np.abs(local) <= car.size_m / 2).all(-1).any(-1)
    assert inside.sum() > 10
    assert (mask != inside).sum() == 0


def test_mask_needs_the_actor_to_be_there() -> None:
    drive = tiny_drive()
    assert actor_mask(drive.cameras["front"], 0, [drive.actors["cone"]]).any()
    assert not actor_mask(drive.cameras["front"], 4, [drive.actors["cone"]]).any()


def test_report_is_a_page_with_its_images(tmp_path: Path) -> None:
    log = TinyLog()
    report = Report(tmp_path, "Tiny <log>")
    metrics = evaluate(GreyRenderer(log.drive), log, replace(PLAN, frames=(1,)), report.add)
    page = report.finish(metrics["camera"]).read_text()
    assert "Tiny &lt;log&gt;" in page and "http" not in page
    names = [part.split('"')[0] for part in page.split('src="')[1:]]
    assert len(names) == 4 + 2, "recorded, rendered, difference, depth; two sweeps"
    assert all((tmp_path / name).is_file() for name in names)


def test_finite_replaces_what_json_lacks() -> None:
    assert finite({"a": [float("nan"), 1.0, np.float32(2)], "b": float("inf")}) == {"a": [None, 1.0, 2.0], "b": None}


MODEL = CameraModel(32, 18, 8.0, 8.0, 16.0, 9.0, lens=OpenCVFisheye(max_angle_deg=80))
LENS_PLAN = EvaluationPlan((1, 3), ("front",), (), None, (0, 2, 4))


class FisheyeLog(TinyLog):
    """The log seen through a fisheye; where that shows nothing, recorded images hold noise."""

    def __init__(self, seed: int) -> None:
        super().__init__(offset=0.1)
        self._seed = seed
        front = replace(self.drive.cameras["front"], model=MODEL)
        self.drive = replace(self.drive, cameras={"front": front})
        mask = image_mask(MODEL)
        assert mask is not None and 0.4 < mask.mean() < 0.9
        self.mask = mask

    def image(self, camera: str, frame: int) -> NDArray[np.uint8]:
        noise = np.random.default_rng([self._seed, frame]).integers(0, 255, (18, 32, 3)).astype(np.uint8)
        return np.where(self.mask[..., None], super().image(camera, frame), noise)


def figures(seed: int, **changes: Any) -> dict[str, Any]:
    log = FisheyeLog(seed)
    return evaluate(GreyRenderer(log.drive), log, replace(LENS_PLAN, **changes))


def test_figures_are_of_what_the_lens_shows() -> None:
    level = [np.rint((0.4 + 0.01 * f**2) * 255) / 255 for f in range(6)]
    metrics = figures(1)
    for record in metrics["per_frame"]:
        f, found = record["frame"], record["camera"]["front"]
        assert found["psnr_db"] == pytest.approx(-20 * np.log10(abs(0.5 - level[f])), abs=1e-3)
        neighbours = abs((level[f - 1] + level[f + 1]) / 2 - level[f])
        assert found["neighbour_average_psnr_db"] == pytest.approx(-20 * np.log10(neighbours), abs=1e-3)
    mask = FisheyeLog(1).mask
    for record in metrics["per_frame"]:
        found = record["camera"]["front"]
        assert found["actors"]["pixels"] + found["outside_actors"]["pixels"] == mask.sum()


def test_what_the_lens_does_not_show_changes_no_figure() -> None:
    """Except SSIM, whose windows look across the border."""
    outline = {"front": (np.full(32, 14), 18)}

    def perceptual(rendered: NDArray[np.float32], recorded: NDArray[np.float32]) -> float:
        return float(np.abs(rendered[~FisheyeLog(0).mask]).max() + recorded.sum())

    for changes in ({}, {"outlines": outline}, {"perceptual": perceptual}, {"width": 16}):
        first, second = (_without_ssim(figures(seed, **changes)) for seed in (1, 2))
        assert first == second


def _without_ssim(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_ssim(member) for key, member in value.items() if key != "ssim"}
    return [_without_ssim(member) for member in value] if isinstance(value, list) else value
