"""A street's truth, worked out once for all methods: each image and sweep in a file that may be deleted at any time."""

from __future__ import annotations

import io
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import OutputError
from ..evaluate.true_edits import TrueEdit, TrueImages, Version
from ..evaluate.truth import EditRegions
from ..files import read_arrays, write_file
from ..sensors.frames import LidarFrame
from ..world.drive import Drive

Arrays = dict[str, NDArray[Any]]
REGIONS = ("edited", "shadow", "seen")


@dataclass(frozen=True)
class KeptTruth:
    """`TrueEdit` with its answers kept in ``folder``, which is for this truth alone."""

    true: TrueEdit
    folder: Path

    def drive(self, version: Version) -> Drive:
        """See `TrueEdit.drive`."""
        return self.true.drive(version)

    def images(self, camera: str, frame: int) -> TrueImages:
        """See `TrueEdit.images`."""

        def work_out() -> Arrays:
            true = self.true.images(camera, frame)
            regions = {name: getattr(true.regions, name) for name in REGIONS}
            return {"edit": true.edit, **regions, **({} if true.replay is None else {"replay": true.replay})}

        arrays = _kept(self.folder / f"{camera}-{frame:06d}.npz", work_out)
        return TrueImages(
            arrays["edit"], arrays.get("replay"), EditRegions(arrays["edited"], arrays["shadow"], arrays["seen"])
        )

    def sweep(self, version: Version, lidar: str, frame: int) -> LidarFrame | None:
        """See `TrueEdit.sweep`: sweeps are quick to trace."""
        return self.true.sweep(version, lidar, frame)


def _kept(path: Path, work_out: Callable[[], Arrays]) -> Arrays:
    with suppress(OutputError):
        arrays = read_arrays(path, OutputError)
        if _fit(arrays):
            return arrays
    arrays = work_out()
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    write_file(path, file.getvalue())
    return arrays


def _fit(arrays: Arrays) -> bool:
    """Return whether arrays are an edit's images and regions."""
    if not {"edit", *REGIONS} <= set(arrays) or arrays["edit"].ndim != 3:
        return False
    images = [arrays[name] for name in ("edit", "replay") if name in arrays]
    size = images[0].shape[:2]
    whole = all(image.shape == (*size, 3) and image.dtype in (np.uint8, np.float32, np.float64) for image in images)
    return whole and all(arrays[name].shape == size and arrays[name].dtype == bool for name in REGIONS)
