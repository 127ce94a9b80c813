"""Images of distorted lenses as pinholes see them: each pixel has the colour that its direction had."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from ncore_drive import LENSES, MadeLog, ncore_drive
from numpy.typing import NDArray
from PIL import Image

from unisim_blender.core.convert import ConvertSource, convert
from unisim_blender.core.formats.common.image_bytes import Rectification, rectification_of
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.formats.writers import writer_named
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole
from unisim_blender.core.world.drive import CameraModel, RollingShutter

WIDE = CameraModel(160, 120, 70.0, 72.0, 81.0, 58.5, RollingShutter(0.02, 0.5), OpenCVFisheye(0.05, -0.01, 0.0, 0.0))


def colours(rays: FloatArray) -> NDArray[np.uint8]:
    """A smooth colour for each direction."""
    return np.asarray(np.nan_to_num(np.rint(127 + 100 * np.sin(3 * rays))), np.uint8)


def pixels(model: CameraModel) -> FloatArray:
    """Directions of an image's pixels."""
    u, v = np.meshgrid(np.arange(model.width) + 0.5, np.arange(model.height) + 0.5)
    return model.unproject(u, v)


def test_a_pixel_has_the_colour_of_its_direction() -> None:
    camera = replace(next(iter(ncore_drive().cameras.values())), model=WIDE)
    rectification = rectification_of(camera)
    assert rectification is not None and rectification.model.is_pinhole
    made = rectification.image(colours(pixels(WIDE))).astype(int)
    rays = pixels(rectification.model)
    u, v, _ = WIDE.project(rays)
    inside = (u > 1) & (u < WIDE.width - 1) & (v > 1) & (v < WIDE.height - 1)
    assert inside.mean() > 0.8
    off = np.abs(made - colours(rays).astype(int))[inside]
    assert off.max() <= 3 and off.mean() < 0.5
    assert (made[(u < -1) | (u > WIDE.width + 1) | (v < -1) | (v > WIDE.height + 1)] == 0).all()
    # it sees as far to the sides as the lens, in coarser pixels
    assert 0.5 * WIDE.pixels_per_rad < rectification.model.fx < 0.7 * WIDE.pixels_per_rad
    assert rectification.about == "ideal: its images are rectified to a pinhole, which leaves out 7 % of what they show"
    barrel = replace(WIDE, lens=OpenCVPinhole(-0.05, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0))
    found = Rectification(replace(camera, model=barrel))
    assert 0.9 * WIDE.fx < found.model.fx < WIDE.fx and "leaves out 3 %" in found.about
    assert rectification_of(replace(camera, model=replace(WIDE, lens=LENSES["ideal"][0]))) is None


def test_what_the_lens_does_not_show_is_black() -> None:
    lens = OpenCVFisheye(0.05, -0.01, 0.0, 0.0, 20.0)
    camera = replace(next(iter(ncore_drive().cameras.values())), model=replace(WIDE, lens=lens))
    rgb = Rectification(camera).image(np.full((120, 160, 3), 200, np.uint8))
    assert (rgb[0, 0] == 0).all() and (rgb[58, 80] == 200).all()
    shown = np.degrees(np.arccos(pixels(Rectification(camera).model)[..., 2])) < 19.0
    assert (rgb[shown] == 200).all() and shown.mean() > 0.05


def test_layouts_without_lenses_get_rectified_images_and_say_so(tmp_path: Path) -> None:
    drive = ncore_drive()
    lidars = {"roof": drive.lidars["roof"]}
    drive = replace(drive, cameras={name: drive.cameras[name] for name in ("distorted", "fisheye")}, lidars=lidars)
    log = MadeLog(drive)
    done = convert(ConvertSource(log, "made"), writer_named("nuscenes"), tmp_path / "out")
    said = [loss for loss in done.losses if "rectified" in loss]
    assert [loss.partition(":")[0] for loss in said] == ["distorted", "fisheye"]
    assert any("roof: beams of a column have one time; they were fired within 33 us" in loss for loss in done.losses)
    found = open_log(done.opens)
    assert len(found.drive.cameras) == 2 and all(one.model.is_pinhole for one in found.drive.cameras.values())
    kitti = convert(ConvertSource(log, "made"), writer_named("kitti"), tmp_path / "kitti")
    (image,) = kitti.opens.glob("image_02/data/0000000001.png")
    with Image.open(image) as one:
        assert one.size == (48, 32)
