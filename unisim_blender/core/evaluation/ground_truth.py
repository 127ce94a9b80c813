"""The ground truth of edits, of logs for which it is known: what other packages provide, and a cache of it.

Another distribution registers logs of a kind in its pyproject.toml:

    [project.entry-points."unisim_blender.ground_truths"]
    name = "module:known_logs"
"""

from __future__ import annotations

import io
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import LogError, OutputError
from ..files import read_arrays, write_file
from ..prepare.scenario import PreparedScenario
from ..registry import Registry
from ..sensors.frames import LidarFrame
from ..world.drive import Drive
from .metrics import ImageArray
from .truth import EditRegions

Version = Literal["edit", "replay"]


@dataclass(frozen=True)
class TrueImages:
    """A camera's true images (H, W, 3) of one frame: of the edit, of the recorded drive where that has the camera, and
    the regions of the edit's."""

    edit: ImageArray
    replay: ImageArray | None
    regions: EditRegions


class Truth(Protocol):
    """The ground truth of an edited drive."""

    def images(self, camera: str, frame: int) -> TrueImages:
        """Return what a camera sees. Raises `UnisimError`."""

    def sweep(self, version: Version, lidar: str, frame: int) -> LidarFrame | None:
        """Return what a LiDAR sees, with exact ranges; None of a recorded drive that has no such LiDAR."""

    def drive(self, version: Version) -> Drive:
        """Return the drive, as edited or as recorded."""


class DrawableTruth(Truth, Protocol):
    """Ground truth of which a part may have to be drawn first."""

    def image(self, version: Version, camera: str, frame: int) -> ImageArray:
        """Return the image (H, W, 3) of a camera of the drive alone. Raises `UnisimError`."""

    def draw(self, scenario: Path, frames: tuple[int, ...], cameras: tuple[str, ...]) -> None:
        """Draw the images of a scenario that are missing and take long. Raises `UnisimError`."""


class KnownLog(Protocol):
    """A log whose ground truth is known, also for edits of it."""

    @property
    def name(self) -> str:
        """The name of its drive."""

    @property
    def recipe(self) -> dict[str, Any]:
        """All that the truth depends on, as JSON has it."""

    def truth(
        self, prepared: PreparedScenario, frames: tuple[int, ...], cameras: tuple[str, ...], width: int | None
    ) -> DrawableTruth:
        """Return the truth of a scenario that was prepared with the log's own poses, images ``width`` pixels wide;
        ``frames`` and ``cameras`` count as seen. Raises `UnisimError`."""

    def usual_edits(self, out: Path) -> tuple[Path, ...]:
        """Return the scenarios that are compared where none are named, written below ``out`` if the log has none."""


class KnownLogs(Protocol):
    """Logs of one kind whose ground truth is known."""

    @property
    def name(self) -> str:
        """Name of the kind."""

    def recognises(self, path: Path) -> bool:
        """Return whether a folder holds such a log."""

    def open(self, path: Path) -> KnownLog:
        """Return the log of a folder. Raises `UnisimError`."""


GROUND_TRUTHS: Registry[KnownLogs] = Registry(
    "a ground truth", "unisim_blender.ground_truths", ("name", "recognises", "open")
)
"""Kinds of logs whose ground truth is known; all are of other packages."""


def known_log(path: Path) -> KnownLog | None:
    """Return the log of a folder with its ground truth; None where that is not known. Raises `UnisimError`."""
    return next((kind.open(path) for kind in GROUND_TRUTHS.with_plugins().values() if kind.recognises(path)), None)


def require_known_log(path: Path) -> KnownLog:
    """Return the log of a folder with its ground truth. Raises `LogError` where that is not known."""
    log = known_log(path)
    if log is None:
        kinds = ", ".join(GROUND_TRUTHS.with_plugins()) or "none"
        raise LogError(f"{path}: has no known ground truth, as logs of these kinds have: {kinds}")
    return log


Arrays = dict[str, NDArray[Any]]
REGION_MASKS = ("edited", "shadow", "seen")


@dataclass(frozen=True)
class CachedTruth:
    """Ground truth whose images are computed once and stored in ``folder``, which is for this truth alone; its files may be
    deleted at any time."""

    true: Truth
    folder: Path

    def drive(self, version: Version) -> Drive:
        return self.true.drive(version)

    def images(self, camera: str, frame: int) -> TrueImages:

        def compute() -> Arrays:
            true = self.true.images(camera, frame)
            regions = {name: getattr(true.regions, name) for name in REGION_MASKS}
            return {"edit": true.edit, **regions, **({} if true.replay is None else {"replay": true.replay})}

        arrays = _cached(self.folder / f"{camera}-{frame:06d}.npz", compute)
        return TrueImages(
            arrays["edit"], arrays.get("replay"), EditRegions(arrays["edited"], arrays["shadow"], arrays["seen"])
        )

    def sweep(self, version: Version, lidar: str, frame: int) -> LidarFrame | None:
        """See `Truth.sweep`: sweeps are quick to trace."""
        return self.true.sweep(version, lidar, frame)


def _cached(path: Path, compute: Callable[[], Arrays]) -> Arrays:
    with suppress(OutputError):
        arrays = read_arrays(path, OutputError)
        if _are_an_edit(arrays):
            return arrays
    arrays = compute()
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    write_file(path, file.getvalue())
    return arrays


def _are_an_edit(arrays: Arrays) -> bool:
    """Return whether arrays are an edit's images and regions."""
    if not {"edit", *REGION_MASKS} <= set(arrays) or arrays["edit"].ndim != 3:
        return False
    images = [arrays[name] for name in ("edit", "replay") if name in arrays]
    size = images[0].shape[:2]
    whole = all(image.shape == (*size, 3) and image.dtype in (np.uint8, np.float32, np.float64) for image in images)
    return whole and all(arrays[name].shape == size and arrays[name].dtype == bool for name in REGION_MASKS)
