"""Training through lenses that do not show all of an image: what they do not show is not learnt from."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from unisim_blender.core.data.images import shown_pixels
from unisim_blender.core.data.log import Log
from unisim_blender.core.data.own_vehicle import find_outline
from unisim_blender.core.errors import LogError
from unisim_blender.core.formats.pandaset.write import PandasetWriter
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.sensors.camera import pixel_directions, pixel_grid
from unisim_blender.core.sensors.unprojection import image_mask
from unisim_blender.core.training.batches.data import CameraData
from unisim_blender.core.training.batches.images import PixelChoice
from unisim_blender.core.training.config import TrainConfig
from unisim_blender.core.training.losses.terms import as_shown, perceptual_stand_in
from unisim_blender.core.training.trainer import Trainer
from unisim_blender.core.world.drive import CameraModel
from unisim_street.street import build_street
from unisim_street.truth import truth_camera, truth_lidar

NAME = "front_camera"
MODEL = CameraModel(64, 48, 16.0, 16.0, 32.0, 24.0, lens=OpenCVFisheye(k1=-0.02, max_angle_deg=85))
CONFIG = TrainConfig(
    cameras=(NAME,), lidars=("pandar64",), frames=(0, 1, 2), preset="tiny", iterations=40, patches=6, patch_cells=8,
    lidar_rays=128, perceptual_from=0.0, poses_from=0.5,
)  # fmt: skip


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    """Three frames of a street through a fisheye whose image circle leaves the corners black."""
    out = tmp_path_factory.mktemp("lenses") / "log"
    made = build_street(3, 2, 64, 48, (NAME,), 0.0)
    drive = replace(made.drive, cameras={NAME: replace(made.drive.cameras[NAME], model=MODEL)})
    writer = PandasetWriter(out, drive)
    for frame in drive.frames:
        rgb = truth_camera(made, drive, NAME, frame).rgb
        writer.write_image(NAME, frame, np.rint(rgb * 255).astype(np.uint8))
        writer.write_sweep(frame, {"pandar64": truth_lidar(made, drive, "pandar64", frame)})
        writer.write_cuboids(frame)
    writer.finish()
    return open_log(out)


@pytest.fixture(scope="module")
def mask() -> NDArray[np.bool_]:
    shown = image_mask(MODEL)
    assert shown is not None and 0.4 < shown.mean() < 0.8
    return shown


def repainted(log: Log, mask: NDArray[np.bool_], seed: int) -> Any:
    """The log with noise in its images where the lens shows nothing."""
    other: Any = copy(log)

    def image(camera: str, frame: int) -> NDArray[np.uint8]:
        noise = np.random.default_rng([seed, frame]).integers(0, 255, (*mask.shape, 3)).astype(np.uint8)
        return np.where(mask[..., None], log.image(camera, frame), noise)

    other.image = image
    return other


def test_a_street_is_learnt_through_a_fisheye(log: Log) -> None:
    trainer = Trainer(log, replace(CONFIG, iterations=60, rate_tables=(3e-2, 3e-2), rate_networks=(1e-2, 1e-2)))
    steps = [trainer.step() for _ in range(60)]
    first, last = (
        {k: np.mean([s[k] for s in part]) for k in ("rgb", "psnr", "loss")} for part in (steps[:6], steps[-6:])
    )
    assert last["rgb"] < 0.7 * first["rgb"] and last["loss"] < 0.7 * first["loss"], (first, last)
    assert last["psnr"] > first["psnr"] + 1, (first, last)


@pytest.mark.parametrize(("preset", "adversarial"), (("tiny", False), ("paper", True)))
def test_what_the_lens_does_not_show_changes_nothing(
    log: Log, mask: NDArray[np.bool_], preset: str, adversarial: bool
) -> None:
    """Neither a term of the loss nor a weight, to the last bit; ``paper`` decodes whole patches."""
    config = replace(CONFIG, adversarial=adversarial, preset=preset, poses_from=0.0, patches=3, lidar_rays=32)
    trained = []
    for seed in (1, 2):
        trainer = Trainer(repainted(log, mask, seed), config)
        trained.append(([trainer.step() for _ in range(3)], trainer.model.state_dict()))
    (steps, weights), (other_steps, other_weights) = trained
    assert steps == other_steps
    assert all(torch.equal(value, other_weights[name]) for name, value in weights.items())


def test_pixels_are_drawn_where_the_lens_shows_something(log: Log, mask: NDArray[np.bool_]) -> None:
    data = CameraData(log, [NAME], [0, 1, 2], None, np.zeros(3))
    rng = np.random.default_rng(0)
    for up in (1, 2):
        choice = PixelChoice(data.rooms(up))
        draw = choice.draw(rng, 40_000)
        drawn = np.zeros(mask.shape, int)
        np.add.at(drawn, (draw.y, draw.x), 1)
        allowed = mask.copy()
        for dy, dx in ((0, 1), (1, 0), (1, 1)) if up == 2 else ():
            allowed &= np.pad(mask, ((0, 1), (0, 1)))[dy:, dx:][: mask.shape[0], : mask.shape[1]]
        assert (drawn[~allowed] == 0).all() and (drawn[allowed] > 0).all()
        # evenly, as no errors have been noted yet
        assert drawn[allowed].std() < 1.3 * np.sqrt(drawn[allowed].mean())
        batch = data.pixels(draw, up)
        assert torch.isfinite(batch.rays.directions).all() and batch.shown is None


def test_patches_say_which_of_their_pixels_are_shown(log: Log, mask: NDArray[np.bool_]) -> None:
    drive = log.drive.cameras[NAME]
    data = CameraData(log, [NAME], [0, 1, 2], None, np.zeros(3))
    batch = data.patches(np.random.default_rng(0), 200, 6, 2)
    assert batch.shown is not None and batch.shown.shape == (200, 1, 12, 12)
    share = batch.shown.mean((1, 2, 3))
    assert (
        share.min() >= 0.45 and share.max() == 1 and (share < 1).any()
    )  # a cell has no ray, whose middle is not shown
    # the lens shows every ray of a marked cell, and none but the marked
    directions = pixel_directions(drive.model, *pixel_grid(drive.model))
    edge = np.cos(drive.model.lens.max_angle_rad)
    assert directions[mask][:, 2].min() > edge
    local = torch.einsum("pij,pni->pnj", batch.world_from_camera, batch.rays.directions.view(200, 36, 3))
    cells = batch.shown[:, 0, ::2, ::2].reshape(200, 36) > 0
    assert local[cells][:, 2].min() > edge - 1e-4


def test_a_pixel_of_a_smaller_image_is_not_shown_where_it_is_dark_in_part(log: Log, mask: NDArray[np.bool_]) -> None:
    """Images at half the width: what the lens does not show makes a pixel of the border darker."""
    bright, dark = (repainted(log, mask, seed) for seed in (1, 2))
    batches = [
        CameraData(one, [NAME], [0, 1, 2], 32, np.zeros(3)).patches(np.random.default_rng(0), 60, 6, 1)
        for one in (bright, dark)
    ]
    first, second = batches
    assert first.shown is not None and second.shown is not None and torch.equal(first.shown, second.shown)
    assert torch.equal(first.target * first.shown, second.target * first.shown)
    # by its own mask alone there would be such pixels
    shown = image_mask(MODEL.resized(32))
    whole = shown_pixels(MODEL, MODEL.resized(32))
    assert shown is not None and whole is not None and (shown & ~whole).sum() > 5 and not (whole & ~shown).any()
    assert shown_pixels(MODEL, MODEL) is image_mask(MODEL)


def test_a_patch_that_does_not_fit_is_refused_in_a_sentence(log: Log) -> None:
    tiny = replace(MODEL, lens=OpenCVFisheye(max_angle_deg=20))
    drive = replace(log.drive, cameras={NAME: replace(log.drive.cameras[NAME], model=tiny)})
    small: Any = copy(log)
    small.drive = drive
    data = CameraData(small, [NAME], [0], None, np.zeros(3))
    with pytest.raises(LogError, match=f"no patch of 32 pixels of camera {NAME} shows the scene"):
        data.patches(np.random.default_rng(0), 1, 16, 2)


def test_perceptual_terms_compare_what_is_shown() -> None:
    rng = torch.Generator().manual_seed(0)
    target, image = (torch.rand(2, 3, 24, 24, generator=rng) for _ in range(2))
    shown = torch.zeros(2, 1, 24, 24)
    shown[..., :10] = 1
    image.requires_grad_()
    perceptual_stand_in(as_shown(image, shown), as_shown(target, shown)).backward()
    assert image.grad is not None
    assert (image.grad * (1 - shown) == 0).all() and (image.grad * shown != 0).float().mean() > 0.3
    assert as_shown(image, None) is image


@pytest.mark.parametrize("bonnet", (False, True))
def test_the_border_of_what_is_shown_is_no_outline_of_a_vehicle(bonnet: bool) -> None:
    """Although it stays where it is, as a bonnet's does."""
    height, width = 120, 200
    v, u = np.mgrid[:height, :width] + 0.5
    shown = ((u - 100) / 130) ** 2 + ((v - 60) / 50) ** 2 < 1
    rng = np.random.default_rng(1)
    images = []
    for _ in range(12):
        grey = np.repeat(np.repeat(rng.uniform(40, 255, (height // 4, width // 4)), 4, 0), 4, 1)
        if bonnet:
            grey[84:] = 230
        images.append(np.repeat((grey * shown).astype(np.uint8)[..., None], 3, -1))
    assert find_outline(images) is not None  # that without a mask it is taken for one is why there is a mask
    outline = find_outline(images, shown)
    if not bonnet:
        assert outline is None
    else:
        assert outline is not None and np.abs(outline[60:140] - 84).max() <= 4
