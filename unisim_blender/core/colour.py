"""The sRGB transfer curve (IEC 61966-2-1). Its primaries are Rec.709's, so only the curve separates the two."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


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


def bytes_from_srgb(srgb: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Eight-bit sRGB (...) of sRGB (...) in 0..1, rounded to nearest."""
    scaled: NDArray[np.float32] = np.rint(np.clip(srgb, 0, 1) * 255)
    return scaled.astype(np.uint8)
