"""Evaluation through a lens that does not show all of an image: what it does not show is not compared."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tiny_drive import GreyRenderer, TinyLog

from unisim_blender.core.evaluation.recorded import EvaluationPlan, evaluate
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.sensors.unprojection import image_mask
from unisim_blender.core.world.drive import CameraModel

MODEL = CameraModel(32, 18, 8.0, 8.0, 16.0, 9.0, lens=OpenCVFisheye(max_angle_deg=80))
PLAN = EvaluationPlan((1, 3), ("front",), (), None, (0, 2, 4))


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
    return evaluate(GreyRenderer(log.drive), log, replace(PLAN, **changes))


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
