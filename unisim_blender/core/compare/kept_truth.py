"""A street's truth, worked out once for all methods: each image and sweep in a file that may be deleted at any time."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..evaluate.true_edits import Part, TrueEdit, TrueImages
from ..evaluate.truth import EditRegions
from ..files import write_file
from ..sensors.frames import LidarFrame
from ..world.drive import Drive

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class KeptTruth:
    """`TrueEdit` with its answers kept in ``folder``, which is for this truth alone."""

    true: TrueEdit
    folder: Path

    def drive(self, part: Part) -> Drive:
        """See `TrueEdit.drive`."""
        return self.true.drive(part)

    def images(self, camera: str, frame: int) -> TrueImages:
        """See `TrueEdit.images`."""

        def work_out() -> Arrays:
            true = self.true.images(camera, frame)
            regions = {name: getattr(true.regions, name) for name in ("edited", "shadow", "seen")}
            return {"edit": true.edit, **regions, **({} if true.replay is None else {"replay": true.replay})}

        arrays = _kept(self.folder / f"{camera}-{frame:06d}.npz", work_out)
        return TrueImages(arrays["edit"], arrays.get("replay"), EditRegions(arrays["edited"], arrays["shadow"], arrays["seen"]))

    def sweep(self, part: Part, lidar: str, frame: int) -> LidarFrame | None:
        """See `TrueEdit.sweep`: sweeps are quick to trace."""
        return self.true.sweep(part, lidar, frame)


def _kept(path: Path, work_out: Callable[[], Arrays]) -> Arrays:
    try:
        with np.load(path) as stored:
            return dict(stored)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        arrays = work_out()
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    write_file(path, file.getvalue())
    return arrays
