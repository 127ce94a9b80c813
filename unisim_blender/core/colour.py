"""The sRGB transfer curve (IEC 61966-2-1). Its primaries are Rec.709's, so only the curve separates the two."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

XYZ_FROM_LINEAR = np.array(
    [[0.412453, 0.357580, 0.180423], [0.212671, 0.715160, 0.072169], [0.019334, 0.119193, 0.950227]]
)
"""CIE XYZ of linear Rec.709 (ITU-R BT.709); its rows' sums are the white point."""


def linear_from_srgb(srgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """Linear Rec.709 (...) of display-referred sRGB (...) in 0..1."""
    srgb = np.asarray(srgb, np.float32)
    high = ((np.maximum(srgb, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(srgb <= 0.04045, srgb / 12.92, high).astype(np.float32)


def srgb_from_linear(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Display-referred sRGB (...) of linear Rec.709 (...) in 0..1."""
    linear = np.asarray(linear, np.float32)
    high = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, linear * 12.92, high).astype(np.float32)


def lab_from_srgb(srgb: NDArray[np.float32]) -> NDArray[np.float64]:
    """CIE L*a*b* 1976 (..., 3) of display-referred sRGB (..., 3) in 0..1, white D65, 2 degree observer."""
    xyz = linear_from_srgb(srgb).astype(np.float64) @ XYZ_FROM_LINEAR.T / XYZ_FROM_LINEAR.sum(1)
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], -1)


def bytes_from_srgb(srgb: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Eight-bit sRGB (...) of sRGB (...) in 0..1, rounded to nearest."""
    scaled: NDArray[np.float32] = np.rint(np.clip(srgb, 0, 1) * 255)
    return scaled.astype(np.uint8)
