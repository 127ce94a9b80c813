"""How far images and depths are from the truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.evaluation.metrics import psnr

NEAR_ENOUGH_MM = 20.0
Pieces = Sequence[NDArray[np.float32]]


def image_error(rendered: Pieces, truth: Pieces) -> dict[str, float]:
    """Of pieces of an image (h, w, 3), sRGB in 0..1, over all their pixels: PSNR in dB, inf where they are equal, and
    the mean colour difference of CIE 1976 (L*a*b*, D65)."""
    from skimage.color import rgb2lab

    a, b = (np.concatenate([np.clip(piece, 0, 1).reshape(-1, 3) for piece in pieces]) for pieces in (rendered, truth))
    untyped: Any = rgb2lab
    lab = [untyped(np.asarray(x, np.float64)) for x in (a, b)]
    return {"psnr_db": psnr(a, b), "delta_e": float(np.linalg.norm(lab[0] - lab[1], axis=-1).mean())}


def depth_error(depth_m: NDArray[np.float32], truth_m: NDArray[np.float32]) -> dict[str, float]:
    """Of depths (...), 0 where a ray hits nothing: absolute errors in mm over rays that hit something in both, the
    share of the truth's rays that hit something which are within 2 cm, and the share of all rays of which it is the
    same whether they hit something. NaN where there are none."""
    a, b = np.asarray(depth_m, np.float64).reshape(-1), np.asarray(truth_m, np.float64).reshape(-1)
    there = b > 0
    both = there & (a > 0)
    error = np.abs(a - b)[both] * 1e3
    nan = float("nan")
    median, p90, p99 = np.percentile(error, (50, 90, 99)) if len(error) else (nan, nan, nan)
    return {
        "median_mm": float(median),
        "p90_mm": float(p90),
        "p99_mm": float(p99),
        "within_2cm": float((error <= NEAR_ENOUGH_MM).sum() / there.sum()) if there.any() else nan,
        "hits_agree": float(((a > 0) == there).mean()) if len(a) else nan,
    }
