"""Common parts of logs that consist of files: `FileLog`, and frame numbers in sentences."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Container, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...data.image_files import Notes
from ...data.log import Sweep, SweepGrid
from ...data.sweep_cells import make_grid, never_returned
from ...errors import LogError, refused
from ...files import cache_folder, file_stamp, write_file
from ...geometry import spread_indices
from ...world.drive import Drive

PNG = b"\x89PNG"


def cached_image(layout: str, store: Path, camera: str, name: str, content: Callable[[], bytes]) -> Path:
    """Return a copy of an image among the user's cached files, written when it is first asked for.

    ``content`` gives the bytes, JPEG or PNG, of the image ``name`` of a camera in the file ``store``; the copy is made
    again where that file changes. Raises what ``content`` does.
    """
    about = f"{store.resolve()} {file_stamp(store)} {camera}"
    folder = cache_folder() / layout / hashlib.sha256(about.encode()).hexdigest()[:24]
    for suffix in (".jpg", ".png"):
        if (folder / f"{name}{suffix}").is_file():
            return folder / f"{name}{suffix}"
    data = content()
    path = folder / f"{name}{'.png' if data.startswith(PNG) else '.jpg'}"
    write_file(path, data)
    return path


SAMPLED_SWEEPS = 8
"""Number of sweeps, spread over a log, from which the cells that the vehicle blocks are found."""


class FileLog(ABC):
    """A log whose images and sweeps are files, or records within files, each found by its sensor and frame.

    A reader fills ``_images``, where each camera's images are by their frames (a path, or a record's number), and
    ``_sweeps``, where sweeps are by their frames; and sets ``drive`` and ``missing``.
    """

    path: Path
    drive: Drive
    missing: tuple[str, ...]

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes = Notes()
        self._images: Mapping[str, Mapping[int, Any]] = {}
        self._sweeps: Mapping[int, Any] = {}
        self._never_returned: dict[str, NDArray[np.bool_]] = {}

    @abstractmethod
    def sweep(self, lidar: str, frame: int) -> Sweep:
        """Return the recorded returns."""

    @abstractmethod
    def _size_stated(self, camera: str) -> str:
        """Return the source of the size of a camera's images, as the beginning of a sentence: "the table gives"."""

    def image_frames(self, camera: str) -> tuple[int, ...]:
        """Captures of which the camera has an image."""
        return tuple(sorted(self._images.get(camera, {})))

    def sweep_frames(self, lidar: str) -> tuple[int, ...]:
        """Frames of which the LiDAR has a sweep."""
        return tuple(sorted(self._sweeps)) if lidar in self.drive.lidars else ()

    def image_path(self, camera: str, frame: int) -> Path | None:
        """Return the file of the recorded image; None where there is none."""
        return self._images.get(camera, {}).get(frame)

    def image(self, camera: str, frame: int) -> NDArray[np.uint8]:
        """Return the recorded image (H, W, 3), sRGB; a grey camera's has three equal channels. Decoding needs
        Pillow."""
        from ...data.images import read_image

        content, where = self._image_content(camera, frame)
        model = self.drive.cameras[camera].model
        stated = f"{self._size_stated(camera)} {model.width}x{model.height}"
        return read_image(content, (model.width, model.height), stated, self.notes, camera, where)

    def _image_content(self, camera: str, frame: int) -> tuple[Path | bytes, str]:
        """Return an image's file, or its bytes and what names them in messages. Raises `LogError` where there is
        none."""
        return self._image_place(camera, frame), ""

    def _image_place(self, camera: str, frame: int) -> Any:
        """Return where an image is. Raises `LogError` where there is none."""
        place = self._images.get(camera, {}).get(frame)
        if place is None:
            raise LogError(f"{self.path}: {camera} has no image of frame {frame}")
        return place

    def _sweep_place(self, lidar: str, frame: int) -> Any:
        """Return where a frame's sweep is. Raises `LogError` where there is none."""
        if lidar not in self.drive.lidars or frame not in self._sweeps:
            raise LogError(f"{self.path}: {lidar} has no sweep of frame {frame}")
        return self._sweeps[frame]

    def sweep_grid(self, lidar: str, frame: int) -> SweepGrid:
        """Return the recorded sweep as beams x columns, with drops. Cells that never return are blocked, where the log
        gives no drops."""
        sweep, sensor = self.sweep(lidar, frame), self.drive.lidars[lidar]
        if sensor.model.beams == 0:
            raise LogError(f"{self.path}: {lidar} does not scan beams x columns, ask for its plain sweep")
        if sweep.drops is not None:
            return make_grid(sweep, sensor, frame, np.zeros((sensor.model.beams, sensor.model.columns), np.bool_))
        return make_grid(sweep, sensor, frame, self._find_never_returned(lidar))

    def _find_never_returned(self, lidar: str) -> NDArray[np.bool_]:
        """Return the cells (beams, columns) that look down and return in none of some sweeps; they are read once."""
        if lidar not in self._never_returned:
            sweeps = [self.sweep(lidar, frame) for frame in spread_over(self.sweep_frames(lidar))]
            self._never_returned[lidar] = never_returned(sweeps, self.drive.lidars[lidar].model)
        return self._never_returned[lidar]


def spread_over(frames: Collection[int], count: int = SAMPLED_SWEEPS) -> list[int]:
    """Return up to ``count`` of some frames, spread over them, in their order: the first and the last are among
    them."""
    every = sorted(frames)
    return [every[at] for at in spread_indices(len(every), count)]


def absent_frames(frames: Collection[int], there: Container[int]) -> str:
    """Return in words which frames are not ``there``: "2 of 80 frames: 3, 7"; "" where all are."""
    absent = [frame for frame in frames if frame not in there]
    return f"{len(absent)} of {len(frames)} frames: {ranges(absent)}" if absent else ""


def ranges(frames: Iterable[int]) -> str:
    """Return frame numbers in words: "3, 7-9"."""
    parts: list[list[int]] = []
    for frame in sorted(frames):
        if parts and frame == parts[-1][1] + 1:
            parts[-1][1] = frame
        else:
            parts.append([frame, frame])
    return ", ".join(str(first) if first == last else f"{first}-{last}" for first, last in parts)


MAX_TEXT_BYTES = 64 * 2**20


def read_text(path: Path) -> str:
    """Return a text file. Raises `LogError`."""
    with refused(path, "read", LogError):
        try:
            if path.stat().st_size > MAX_TEXT_BYTES:
                raise LogError(f"{path}: refused, it has more than {MAX_TEXT_BYTES // 2**20} MiB")
            return path.read_text(encoding="utf-8")
        except FileNotFoundError as error:
            raise LogError(f"{path}: is missing") from error
