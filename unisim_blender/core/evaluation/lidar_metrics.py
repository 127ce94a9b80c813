"""How far a rendered sweep is from a recorded one, ray by ray, with numpy alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry import BoolArray


def lidar_metrics(
    depth_m: NDArray[np.float32],
    intensity: NDArray[np.float32],
    returned: BoolArray,
    recorded_depth_m: NDArray[np.float32],
    recorded_intensity: NDArray[np.float32],
    recorded_returned: BoolArray,
) -> dict[str, float]:
    """Compare the same rays (N,), rendered and recorded; cells that the vehicle blocks must have been left out.

    Depth errors are absolute, over rays that return in both; ``hit_rate`` is the share of recorded returns that return
    here too; ``drop_accuracy`` the share of all rays of which it is the same whether they return; ``intensity_rmse``
    over rays that return in both. ``depth_median_squared_m2`` is the median squared error, which NeuRAD's
    tables call "depth".
    """
    assert depth_m.shape == recorded_depth_m.shape, f"depths of shapes {depth_m.shape} and {recorded_depth_m.shape}"
    both = returned & recorded_returned
    error = np.abs(np.asarray(depth_m, np.float64) - recorded_depth_m)[both]
    difference = np.asarray(intensity, np.float64)[both] - recorded_intensity[both]
    some = len(error) > 0
    nan = float("nan")
    return {
        "depth_median_m": float(np.median(error)) if some else nan,
        "depth_p90_m": float(np.percentile(error, 90)) if some else nan,
        "depth_mean_m": float(error.mean()) if some else nan,
        "depth_median_squared_m2": float(np.median(error**2)) if some else nan,
        "hit_rate": float(both.sum() / recorded_returned.sum()) if recorded_returned.any() else nan,
        "drop_accuracy": float((returned == recorded_returned).mean()) if returned.size else nan,
        "intensity_rmse": float(np.sqrt(np.mean(difference**2))) if some else nan,
    }
