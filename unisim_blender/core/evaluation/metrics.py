"""How far a rendered frame is from a recorded or true one.

Images are sRGB in 0..1, as they are shown. PSNR = -10 log10(mean squared error over all pixels and channels). SSIM
follows Wang et al., "Image quality assessment" (2004): an 11 x 11 Gaussian window with sigma 1.5, K1 = .01, K2 = .03,
population covariance, colour channels averaged, a border of 5 pixels left out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skimage.metrics import structural_similarity

from ..geometry import BoolArray, FloatArray

ImageArray = NDArray[np.float32]
SSIM_WINDOW = 11


def mean_squared_error(rendered: ImageArray, recorded: ImageArray, mask: BoolArray | None = None) -> float:
    """Mean of squared differences (H, W, 3) over the mask's pixels (H, W); NaN where the mask is empty."""
    assert rendered.shape == recorded.shape, f"images of shapes {rendered.shape} and {recorded.shape}"
    squares = (np.asarray(rendered, np.float64) - np.asarray(recorded, np.float64)) ** 2
    if mask is not None:
        squares = squares[mask]
    return float(squares.mean()) if squares.size else float("nan")


def psnr_from_error(mean_square: float) -> float:
    """Peak signal-to-noise ratio in dB for a peak of 1; inf where the images are equal."""
    return float("inf") if mean_square == 0 else -10 * float(np.log10(mean_square))


def psnr(rendered: ImageArray, recorded: ImageArray, mask: BoolArray | None = None) -> float:
    """PSNR in dB of images (H, W, 3), within the mask (H, W) where one is given; NaN where it is empty."""
    return psnr_from_error(mean_squared_error(rendered, recorded, mask))


def ssim(rendered: ImageArray, recorded: ImageArray, mask: BoolArray | None = None) -> float:
    """Structural similarity of images (H, W, 3), averaged over windows centred in the mask (H, W) where one is given.

    NaN where an image is smaller than the window or the mask is empty.
    """
    if min(recorded.shape[:2]) < SSIM_WINDOW:
        return float("nan")
    untyped: Any = structural_similarity
    mean, full = untyped(
        np.asarray(recorded, np.float64),
        np.asarray(rendered, np.float64),
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=-1,
        full=True,
    )
    if mask is None:
        return float(mean)
    border = SSIM_WINDOW // 2
    inner = (slice(border, -border), slice(border, -border))
    values = full[inner][mask[inner]]
    return float(values.mean()) if values.size else float("nan")


def chamfer(rendered: FloatArray, recorded: FloatArray) -> dict[str, float]:
    """Distance of two point clouds (N, 3) and (M, 3) by nearest neighbours; NaN where one is empty.

    ``chamfer_m``: the mean distance from each rendered point to the nearest recorded one and the mean distance back,
    averaged. ``chamfer_squared_m2``: squared distances both ways, summed and divided by the number of recorded points,
    as NeuRAD (Tonderski et al., 2024) reports it.
    """
    if len(rendered) == 0 or len(recorded) == 0:
        return {"chamfer_m": float("nan"), "chamfer_squared_m2": float("nan")}
    forward, _ = cKDTree(recorded).query(rendered)
    backward, _ = cKDTree(rendered).query(recorded)
    squares = float(np.sum(forward**2) + np.sum(backward**2))
    return {"chamfer_m": float(np.mean(forward) + np.mean(backward)) / 2, "chamfer_squared_m2": squares / len(recorded)}


def mean_of(frames: list[dict[str, Any]], name: str) -> float | None:
    """Mean of one metric over the frames that have a finite value of it; None where there is none."""
    values = [frame[name] for frame in frames if frame.get(name) is not None and np.isfinite(frame[name])]
    return float(np.mean(values)) if values else None
