"""Lenses that a street's cameras may have in place of an ideal pinhole, each with about the parameters of a recorded one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from unisim_blender.core.lenses import PINHOLE
from unisim_blender.core.lenses.f_theta import FTheta
from unisim_blender.core.lenses.lens import Lens
from unisim_blender.core.lenses.mei import Mei
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole
from unisim_blender.core.world.drive import CameraModel


@dataclass(frozen=True)
class StreetLens:
    """A lens, and how many degrees an image's width spans through it; None: as many as without it."""

    lens: Lens
    across_deg: float | None = None


USUAL = "pinhole"
STREET_LENSES = {
    USUAL: StreetLens(PINHOLE),
    "opencv": StreetLens(OpenCVPinhole(k1=-0.24, k2=0.09, p1=4e-4, p2=-3e-4, k3=-0.012)),
    "fisheye": StreetLens(OpenCVFisheye(k1=-0.02, k2=0.004, k3=-0.003, k4=4e-4, max_angle_deg=105.0), 150.0),
    "ftheta": StreetLens(FTheta(radius_from_angle=(1.0, 0.0, -0.03, 0.004), max_angle_deg=75.0), 120.0),
    "mei": StreetLens(Mei(xi=1.6, k1=-0.03, k2=0.01, p1=3e-4, p2=-2e-4), 185.0),
}
"""By the names that recipes and `unisim synth --lens` have. Where an image reaches beyond what its lens shows, it is black."""


def through(model: CameraModel, name: str) -> CameraModel:
    """Return a pinhole camera with a lens of `STREET_LENSES` instead, its image spanning the degrees that the lens says."""
    chosen = STREET_LENSES[name]
    if chosen.lens == PINHOLE:
        return model
    half = np.arctan(model.width / 2 / model.fx) if chosen.across_deg is None else np.radians(chosen.across_deg) / 2
    plane, _ = chosen.lens.project(np.array([np.sin(half), 0.0, np.cos(half)]))
    focal = float(model.width / 2 / plane[0])
    return replace(model, fx=focal, fy=focal, lens=chosen.lens)
