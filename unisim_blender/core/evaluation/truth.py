"""Edited frames against the truth of their edit, and beside them the unedited drive's frames against theirs.

The edited region is where the truth itself changes: pixels that show something else than before, and shadow pixels,
whose light alone changed. A pixel is seen where what it shows stood in some image that was trained on. The replay's
metrics are measured on the same frames, and within the same pixels, so that the cost of an edit can be read off as
their difference.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..data.log import SweepRays
from ..geometry import BoolArray
from ..sensors.frames import LidarFrame
from .images import ReturnCloud
from .metrics import ImageArray, mean_of
from .recorded import RayRenderer, camera_metrics, compare_rays, finite, image_metrics

REGIONS = (
    "edited",
    "outside_edit",
    "edited_without_shadow",
    "frame_without_shadow",
    "edited_seen",
    "edited_never_seen",
    "frame_seen",
    "frame_never_seen",
)


@dataclass(frozen=True)
class EditRegions:
    """Masks (H, W): pixels that show something else, those whose light alone changed, and what was seen in training."""

    edited: BoolArray
    shadow: BoolArray
    seen: BoolArray

    def __post_init__(self) -> None:
        shapes = self.edited.shape, self.shadow.shape, self.seen.shape
        assert len(set(shapes)) == 1, f"masks of shapes {shapes}"

    @property
    def changed(self) -> BoolArray:
        """The edited region, its shadow pixels included."""
        return self.edited | self.shadow

    def masks(self) -> dict[str, BoolArray]:
        changed = self.changed
        return {
            "edited": changed,
            "outside_edit": ~changed,
            "edited_without_shadow": self.edited & ~self.shadow,
            "frame_without_shadow": ~self.shadow,
            "edited_seen": changed & self.seen,
            "edited_never_seen": changed & ~self.seen,
            "frame_seen": self.seen,
            "frame_never_seen": ~self.seen,
        }


def edit_image_metrics(rendered: ImageArray, truth: ImageArray, regions: EditRegions) -> dict[str, Any]:
    """Metrics of a rendered image over the frame and within each region."""
    return image_metrics(rendered, truth, regions.masks())


def lidar_metrics_beside(
    renderer: RayRenderer, truth: LidarFrame, blocked: BoolArray | None
) -> tuple[dict[str, Any], ReturnCloud, ReturnCloud]:
    """Render the rays of a true sweep, those that the vehicle blocks left out; see `compare_rays`."""
    cells = np.ones(truth.returned.shape, bool) if blocked is None else ~blocked
    rays = SweepRays(
        truth.origins[cells], truth.directions[cells], truth.time_s[cells],
        truth.depth_m[cells], truth.intensity[cells], truth.returned[cells],
    )  # fmt: skip
    return compare_rays(renderer, rays, truth.model)


def summarise_truth(per_frame: list[dict[str, Any]]) -> dict[str, Any]:
    """Mean metrics of edit and replay over all frames and sensors, and what the edit costs in dB beside the replay."""
    summary: dict[str, Any] = {"camera": {}, "lidar": {}}
    for part in ("edit", "replay"):
        images = [metrics[part] for record in per_frame for metrics in record["camera"].values() if part in metrics]
        sweeps = [metrics[part] for record in per_frame for metrics in record["lidar"].values() if part in metrics]
        summary["camera"][part] = camera_metrics(images, REGIONS)
        summary["lidar"][part] = {
            "sweeps": len(sweeps),
            **{name: mean_of(sweeps, name) for name in (sweeps or [{}])[0]},
        }
    edit, replay = summary["camera"]["edit"], summary["camera"]["replay"]
    summary["camera"]["edit_costs_db"] = {
        "frame": _difference(replay["psnr_db"], edit["psnr_db"]),
        **{region: _difference(replay[region]["psnr_db"], edit[region]["psnr_db"]) for region in REGIONS},
        "edited_beside_whole_replay": _difference(replay["psnr_db"], edit["edited"]["psnr_db"]),
    }
    result: dict[str, Any] = finite(summary)
    return result


def _difference(replay: float | None, edit: float | None) -> float | None:
    return None if replay is None or edit is None else replay - edit
