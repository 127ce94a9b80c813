"""Cases of lenses: the edge of their valid domain, points of any size, and images of which they show little."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.lenses.f_theta import FTheta
from unisim_blender.core.lenses.lens import Lens
from unisim_blender.core.lenses.mei import Mei
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole
from unisim_blender.core.sensors.camera import pixel_directions, pixel_grid
from unisim_blender.core.sensors.unprojection import has_direction, image_mask
from unisim_blender.core.world.drive import CameraModel

from .measures import Bench, Measure, most

FOCAL_PX = 1000.0
LENSES: dict[str, Lens] = {
    "barrel that folds": OpenCVPinhole(k1=-0.3),
    "tangential": OpenCVPinhole(k1=-0.25, k2=0.08, p1=0.01, p2=-0.01, k3=-0.01),
    "beside a pole": OpenCVPinhole(k1=0.2, k4=-0.4),
    "thin prism": OpenCVPinhole(k1=0.1, s1=0.02, s2=-0.003, s3=0.02, s4=0.002),
    "next to nothing": OpenCVPinhole(k1=-900.0),
    "fisheye, all round": OpenCVFisheye(),
    "fisheye that folds": OpenCVFisheye(k1=-0.05, k2=-0.01),
    "fisheye, 1.5 degrees": OpenCVFisheye(max_angle_deg=1.5),
    "f-theta": FTheta((1.0, 0.02, -0.05), (), 175.0, (1.01, 0.004, -0.003)),
    "f-theta backwards": FTheta((), (0.6, 0.1, -0.02), 170.0),
    "parabolic mirror": Mei(1.0),
    "mei beyond 1": Mei(2.5, -0.1, 0.02, 0.001, -0.002),
    "mei like a pinhole": Mei(0.0, -0.1),
}


def cone(angles: FloatArray, count: int) -> FloatArray:
    """Unit directions (len(angles) * count, 3) at angles from the optical axis."""
    angle, heading = np.meshgrid(angles, np.linspace(0, 2 * np.pi, count, endpoint=False) + 0.1, indexing="ij")
    rays = np.stack([np.sin(angle) * np.cos(heading), np.sin(angle) * np.sin(heading), np.cos(angle)], -1)
    return rays.reshape(-1, 3)


def lens_edges(bench: Bench) -> Iterator[Measure]:
    """Directions on the axis, next to it, and nearer and nearer to the edge of the valid domain; then beyond it."""
    small = 10.0 ** -np.arange(1.0, 16.0)
    for name, lens in LENSES.items():
        end = lens.max_angle_rad
        inside = cone(np.concatenate([[0.0, end], end * small, end * (1 - small)]), 25 * bench.full)
        plane, valid = lens.project(inside)
        yield Measure(f"{name}: directions of the domain that are left out", float((~valid).sum()), 0)
        again, shown = lens.project(lens.unproject(plane))
        yield Measure(f"{name}: places that are left out", float((~shown).sum()), 0)
        # of a float64 the last bit is a part of the place itself
        off = np.abs(again - plane).max(1) / np.maximum(1.0, np.abs(plane).max(1) / 50)
        yield Measure(f"{name}: places after there and back, pixels", most(off * FOCAL_PX, 0 * off), 1e-6)
        steady = cone(end * np.linspace(0, 0.9, 40), 25 * bench.full)
        back = lens.unproject(lens.project(steady)[0])
        yield Measure(f"{name}: directions there and back, rad", most(back, steady), 1e-7)
        if end < math.pi * 0.999:
            beyond = cone(np.minimum(end * (1 + small[:9]), math.pi), 25 * bench.full)
            plane, valid = lens.project(beyond)
            yield Measure(
                f"{name}: directions beyond that are let in", float((valid | np.isfinite(plane[:, 0])).sum()), 0
            )


def lens_points(bench: Bench) -> Iterator[Measure]:
    """Points as near and as far as float64 has them, and some that are none."""
    for name, lens in LENSES.items():
        rays = cone(np.linspace(0.02, 0.9, 30) * lens.max_angle_rad, 9 * bench.full)
        plane, _ = lens.project(rays)
        for power in (-290, -150, 150, 300):
            far, valid = lens.project(rays * 10.0**power)
            error = most(far, plane) * FOCAL_PX if valid.all() else math.inf
            yield Measure(f"{name}: places of points 1e{power} m off, pixels", error, 1e-6)
        none = np.array([
            [0.0, 0, 0], [np.nan, 0, 1], [0, np.inf, 1], [0, 0, -np.inf], [np.inf, np.inf, np.inf], [np.nan] * 3
        ])  # fmt: skip
        plane, valid = lens.project(none)
        yield Measure(
            f"{name}: points that are none, and have a place", float((valid | ~np.isnan(plane[:, 0])).sum()), 0
        )
        rays = lens.unproject(np.array([[np.nan, 0.0], [0.0, np.inf], [-np.inf, np.nan]]))
        yield Measure(f"{name}: places that are none, and have a direction", float((~np.isnan(rays)).sum()), 0)


def lens_images(bench: Bench) -> Iterator[Measure]:
    """Images whose lens shows all of them, a part, or a few pixels: every ray is a direction, the shown ones project back."""
    width, height = 48 * bench.full, 32 * bench.full
    for name, lens in LENSES.items():
        for focal in (0.02 * width, 0.3 * width, 20.0 * width):
            model = CameraModel(width, height, focal, 0.9 * focal, 0.45 * width, 0.55 * height, lens=lens)
            u, v = pixel_grid(model)
            rays, shown, mask = pixel_directions(model, u, v), has_direction(model, u, v), image_mask(model)
            what = f"{name}, focal length {focal:g}"
            yield Measure(f"{what}: lengths of rays", most(np.linalg.norm(rays, axis=-1), 1.0), 1e-12)
            yield Measure(f"{what}: mask", float((shown != (True if mask is None else mask)).sum()), 0)
            at_u, at_v, valid = model.project(rays)
            yield Measure(f"{what}: rays that are no direction of the lens", float((~valid).sum()), 0)
            off = np.maximum(np.abs(at_u - u), np.abs(at_v - v))[shown]
            yield Measure(f"{what}: places of rays, pixels", most(off, 0 * off), 1e-6)
        far = pixel_directions(model, np.array([1e12, -1e12, 1e300, 0.0]), np.array([0.0, 1e12, -1e300, -1e15]))
        yield Measure(f"{name}: rays of pixels far off that are not finite", float((~np.isfinite(far)).sum()), 0)
