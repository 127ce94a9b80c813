"""Observed space of a recording: surfaces that it shows, free space that it looked through, the background behind it.

A view from outside looks at places that no recorded ray reached, and a trained scene has noise there. Clipped to this,
a view shows the static field from where its rays first enter space that a recorded ray passed through, in voxels that
the recording shows, and the background in directions in which a recorded camera saw it. Everything else is unobserved.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..data.own_vehicle import Outline, outlines_from_json, shows_scene
from ..errors import OutputError
from ..files import cache_folder, partial_file, read_arrays
from ..geometry import BoolArray, FloatArray, invert_pose, transform_points
from ..model.scene_file import SceneHeader, weights_hash
from ..sensors.camera import camera_rays, pixel_grid
from ..sensors.frames import RenderStats
from ..sensors.lidar import lidar_rays
from ..sensors.rays import Rays, exposure_window
from ..sensors.unprojection import has_direction
from ..world.drive import Camera, Lidar
from ..world.replay import DriveStates
from .tracer import NEAR_M, Backend

SPACE_VERSION = 1
"""Version of the cached spaces: to be raised when the same scene gives another space."""
MAX_FRAMES_PER_SENSOR = 10
"""Largest number of frames of each sensor whose rays are followed."""
IMAGE_COLUMNS, SWEEP_BEAMS = 128, 24
"""Approximate number of rays across an image, and of beams of a sweep, that are followed."""
AZIMUTH_CELLS, ELEVATION_CELLS = 180, 90
"""Number of cells of azimuth and of elevation by which directions of the background are known, two degrees each."""
DILATION_CELLS = 2
"""Number of cells by which the directions in which the background was seen are dilated."""
MAX_CACHED_SCENES = 64
"""Largest number of scenes whose observed spaces stay in the cache folder."""


Observed = tuple[SceneHeader, NDArray[Any], float]
"""A scene's header, its voxels (X, Y, Z) that the recording shows, the voxels' edge in metres."""


@runtime_checkable
class Observing(Backend, Protocol):
    """Backend of a trained scene that knows what its recording shows."""

    @property
    def observed(self) -> Observed:
        """The scene's header, shown voxels and voxel edge, which an observed space is made from."""

    def within(self, space: ObservedSpace, clip: bool) -> Backend:
        """Return the backend with support decided by an observed space and, where ``clip``, nothing shown outside of
        it."""


@dataclass(frozen=True)
class ObservedSpace:
    """``shown`` (X, Y, Z): voxels that images or LiDAR returns end in; ``passed`` (X, Y, Z): those that recorded rays
    pass through before; ``background`` (elevations, azimuths): parts of the world's directions in which cameras saw
    past the volume."""

    volume_from_world: FloatArray
    size_m: FloatArray
    voxel_m: float
    shown: BoolArray
    passed: BoolArray
    background: BoolArray

    @cached_property
    def _clearance(self) -> NDArray[np.uint8]:
        """Lower bounds (X, Y, Z) of the chessboard distances, in voxels, to the nearest voxel that was passed and is
        not shown."""
        return clearance(self.passed & ~self.shown)

    def starts(self, rays: Rays) -> NDArray[np.float32]:
        """Return the distances (N,), metres, along flat rays (N,) to the first voxel that a recorded ray passed
        through; inf where there is none.

        For a ray that starts where no recorded ray passed, that voxel must not be a shown one: beside surfaces, where
        recorded rays went slightly too far into a wall, its back would be seen.
        """
        o, d = (np.ascontiguousarray(x, np.float64) for x in self._into(rays))
        first = self._first(o, d)
        cell = np.floor(o / self.voxel_m).astype(np.int64)
        inside = ((cell >= 0) & (cell < self.passed.shape)).all(1)
        i, j, k = cell[inside].T
        first[np.flatnonzero(inside)[self.passed[i, j, k]]] = NEAR_M
        return first

    def _first(self, o: FloatArray, d: FloatArray) -> NDArray[np.float32]:
        """Return the distances (N,), metres, along rays (N, 3), volume coordinates, to the first voxel of clearance 0,
        by the kernel where the library was built."""
        library = native.library()
        if library is None:
            return self.first_reference(o, d)
        out, size = np.empty(len(o), np.float32), np.ascontiguousarray(self.size_m, np.float64)
        shape, clear = np.array(self.passed.shape, np.int32), self._clearance
        library.unisim_first_marked(
            o.ctypes.data, d.ctypes.data, len(o), NEAR_M, size.ctypes.data, clear.ctypes.data, shape.ctypes.data,
            self.voxel_m,
            out.ctypes.data, native.threads(),
        )  # fmt: skip
        return out

    def _into(self, rays: Rays) -> tuple[FloatArray, FloatArray]:
        """Origins and directions (N, 3) in the volume's coordinates."""
        return transform_points(self.volume_from_world, rays.origins), rays.directions @ self.volume_from_world[
            :3, :3
        ].T

    def first_reference(self, o: FloatArray, d: FloatArray) -> NDArray[np.float32]:
        """`_first` in numpy."""
        safe = np.where(np.abs(d) < 1e-9, 1e-9, d)
        a, b = -o / safe, (self.size_m - o) / safe
        t, far = np.minimum(a, b).max(1).clip(NEAR_M), np.maximum(a, b).min(1)
        out = np.full(len(o), np.inf, np.float32)
        number = np.flatnonzero(t < far)
        fastest = np.abs(d).max(1)
        clear, last = self._clearance, np.array(self.passed.shape) - 1
        while len(number):
            at = o[number] + t[number, None] * d[number]
            i, j, k = np.clip((at / self.voxel_m).astype(np.int64), 0, last).T
            free = clear[i, j, k]
            there = free == 0
            out[number[there]] = t[number[there]]
            number, free = number[~there], free[~there]
            # within a voxel less than the distance there is none; beside one the way goes on in half voxels
            t[number] += np.maximum((free - 1.0) / fastest[number], 0.5) * self.voxel_m
            number = number[t[number] < far[number]]
        return out

    def background_seen(self, directions: FloatArray) -> BoolArray:
        """Return whether a recorded camera saw the background in directions (N, 3), world frame: (N,) bool."""
        return np.asarray(self.background[direction_parts(directions)])

    def supported(self, rays: Rays, depth_m: NDArray[Any], instance: NDArray[Any], clipped: bool) -> BoolArray:
        """Return whether flat rays (N,) end at an actor, at something that the recording shows, or at a background that
        it saw: (N,) bool. ``depth_m`` (N,) is inf and ``instance`` (N,) 0 where nothing and no actor was hit.
        ``clipped``: only what the recording shows was hit."""
        assert depth_m.shape == instance.shape == rays.time_s.shape, (depth_m.shape, instance.shape, rays.time_s.shape)
        out = instance > 0
        number = np.flatnonzero(~out & np.isfinite(depth_m))
        ends = rays.origins[number] + rays.directions[number] * depth_m[number, None].astype(np.float64)
        x = transform_points(self.volume_from_world, ends)
        inside = ((x >= 0) & (x <= self.size_m)).all(1)
        number, x = number[inside], x[inside]
        if clipped:
            out[number] = True
        else:
            i, j, k = np.clip((x / self.voxel_m).astype(np.int64), 0, np.array(self.shown.shape) - 1).T
            out[number] = self.shown[i, j, k]
        past = instance <= 0
        past[number] = False
        out[past] = self.background_seen(rays.directions[past])
        return out


def direction_parts(directions: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows and columns (N,) of directions (N, 3), world frame, in the grid by which the background is known."""
    elevation = np.arcsin(np.clip(directions[:, 2], -1, 1)) / np.pi + 0.5
    azimuth = np.arctan2(directions[:, 1], directions[:, 0]) / (2 * np.pi) + 0.5
    rows = np.clip((elevation * ELEVATION_CELLS).astype(np.int64), 0, ELEVATION_CELLS - 1)
    return rows, (azimuth * AZIMUTH_CELLS).astype(np.int64) % AZIMUTH_CELLS


def clearance(marked: BoolArray) -> NDArray[np.uint8]:
    """Return chessboard distances (X, Y, Z), in voxels, to the nearest voxel of ``marked`` (X, Y, Z), at most 255;
    lower bounds where there are no kernels."""
    library = native.library()
    if library is not None:
        closed, shape = np.ascontiguousarray(marked, np.uint8), np.array(marked.shape, np.int32)
        out = np.empty_like(closed)
        library.unisim_clearance(closed.ctypes.data, shape.ctypes.data, out.ctypes.data)
        return out
    out, reached = np.full(marked.shape, 8, np.uint8), marked
    for distance in range(8):
        out[reached & (out == 8)] = distance
        reached = dilated(reached)
    return out


def dilated(marked: BoolArray) -> BoolArray:
    """Return the voxels (X, Y, Z) bool that are marked or adjacent to a marked one."""
    for axis in range(marked.ndim):
        out = marked.copy()
        before, after = ([slice(None)] * marked.ndim for _ in range(2))
        before[axis], after[axis] = slice(None, -1), slice(1, None)
        out[tuple(after)] |= marked[tuple(before)]
        out[tuple(before)] |= marked[tuple(after)]
        marked = out
    return marked


def observe_space(
    backend: Backend, header: SceneHeader, shown: NDArray[Any], voxel_m: float
) -> Iterator[float | ObservedSpace]:
    """Follow rays of the recorded sensors through a trained scene: yield the fractions of work done, and last the
    observed space.

    ``shown`` (X, Y, Z) are the voxels that training noted as shown. Rays are a part of those that the
    scene was trained on.
    """
    observing = _Observing(header, shown.shape, voxel_m)
    drive, training = header.drive, header.training
    frames = [frame for frame in training.get("frames", ()) if frame in drive.time_s] or list(drive.frames)
    frames = frames[:: -(-len(frames) // MAX_FRAMES_PER_SENSOR)]
    outlines = outlines_from_json(training.get("own_vehicle"))
    states = DriveStates(drive, backend.parked)
    appearances: list[tuple[Camera | Lidar, Callable[[float], Rays], float]] = []
    for name in training.get("cameras", ()):
        if (camera := drive.cameras.get(name)) is not None:
            rays_at = _image_rays(camera, outlines.get(name))
            appearances += [(camera, rays_at, camera.time_s[frame]) for frame in frames if frame in camera.time_s]
    for name in training.get("lidars", ()):
        if (lidar := drive.lidars.get(name)) is not None and lidar.model.beams:
            appearances += [
                (lidar, _sweep_rays(lidar), lidar.time_s[frame]) for frame in frames if frame in lidar.time_s
            ]
    for done, (sensor, rays_at, time_s) in enumerate(appearances):
        yield done / len(appearances)
        rays, images = rays_at(time_s).flat().sound(), isinstance(sensor, Camera)
        tracer = backend.bind(states.state(*exposure_window(sensor, time_s)))
        observing.add(rays, tracer.trace(rays, {"depth"}, images, None, RenderStats()).maps["depth"], images)
    yield ObservedSpace(
        observing.volume_from_world,
        observing.size_m,
        voxel_m,
        np.asarray(shown) > 0,
        closed(observing.passed),
        spread(observing.background),
    )


def _image_rays(camera: Camera, outline: tuple[Outline, int] | None) -> Callable[[float], Rays]:
    """Return a function that gives some of a camera's rays at a time, the recording vehicle's own body left out."""
    u, v = pixel_grid(camera.model, max(1, camera.model.width // IMAGE_COLUMNS))
    if not camera.model.is_pinhole:
        shown = has_direction(camera.model, u, v)
        u, v = u[shown], v[shown]
    if outline is not None:
        outside = shows_scene(*outline, u, v, (camera.model.width, camera.model.height))
        u, v = u[outside], v[outside]
    return lambda time_s: camera_rays(camera, time_s, u.reshape(1, -1), v.reshape(1, -1))


def _sweep_rays(lidar: Lidar) -> Callable[[float], Rays]:
    """Return a function that gives a subset of the beams of a LiDAR's sweep at a time."""
    every, beside = max(1, lidar.model.beams // SWEEP_BEAMS), max(1, lidar.model.columns // 720)

    def rays_at(time_s: float) -> Rays:
        rays = lidar_rays(lidar, time_s)
        return Rays(*(x[::every, ::beside] for x in (rays.origins, rays.directions, rays.time_s)))

    return rays_at


class _Observing:
    """Voxels that rays passed through, and parts of the background that they saw, accumulated ray by ray."""

    def __init__(self, header: SceneHeader, shape: tuple[int, ...], voxel_m: float) -> None:
        self.volume_from_world = invert_pose(np.asarray(header.volume["world_from_volume"], np.float64))
        self.size_m, self.voxel_m = np.asarray(header.volume["size_m"], np.float64), voxel_m
        self.passed = np.zeros(shape, bool)
        self.background = np.zeros((ELEVATION_CELLS, AZIMUTH_CELLS), bool)

    def add(self, rays: Rays, depth_m: NDArray[Any], images: bool) -> None:
        """Note what rays (N,) pass through before depths (N,), inf where nothing stops them; of images,
        the background too."""
        o = transform_points(self.volume_from_world, rays.origins)
        d = rays.directions @ self.volume_from_world[:3, :3].T
        safe = np.where(np.abs(d) < 1e-9, 1e-9, d)
        far = np.maximum(-o / safe, (self.size_m - o) / safe).min(1)
        past = depth_m >= far
        if images:
            self.background[direction_parts(rays.directions[past])] = True
        # a beam that does not return says nothing about its way
        reach = np.where(past, far if images else 0.0, depth_m - self.voxel_m)
        flat, shape = self.passed.reshape(-1), np.array(self.passed.shape)
        order = np.argsort(-reach)
        o, d, reach = o[order], d[order], reach[order]
        for step in range(int(max(0.0, reach.max(initial=0.0)) / self.voxel_m) + 1):
            t = (step + 0.5) * self.voxel_m
            count = int(np.searchsorted(-reach, -t, side="left"))
            cell = np.floor((o[:count] + t * d[:count]) / self.voxel_m).astype(np.int64)
            cell = cell[((cell >= 0) & (cell < shape)).all(1)]
            flat[(cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]] = True


def closed(passed: BoolArray) -> BoolArray:
    """Return the voxels (X, Y, Z) with the gaps between rays, one or two voxels wide, closed."""
    padded = np.pad(passed, 1)
    return ~dilated(~dilated(padded))[1:-1, 1:-1, 1:-1]


def spread(background: BoolArray) -> BoolArray:
    """Return directions (elevations, azimuths) dilated by `DILATION_CELLS`; azimuths wrap around."""
    padded = np.pad(
        np.pad(background, ((0, 0), (DILATION_CELLS, DILATION_CELLS)), mode="wrap"),
        ((DILATION_CELLS, DILATION_CELLS), (0, 0)),
    )
    for _ in range(DILATION_CELLS):
        padded = dilated(padded)
    return padded[DILATION_CELLS:-DILATION_CELLS, DILATION_CELLS:-DILATION_CELLS]


def cached_space(header: SceneHeader, shown: NDArray[Any], voxel_m: float) -> ObservedSpace | None:
    """Return a scene's observed space from the user's cache folder; None where it is missing or broken."""
    with suppress(OutputError, KeyError):
        arrays = read_arrays(_file(header), OutputError)
        bits = {"passed": shown.size, "background": ELEVATION_CELLS * AZIMUTH_CELLS}
        if all(
            arrays[name].dtype == np.uint8 and arrays[name].shape == (-(-count // 8),) for name, count in bits.items()
        ):
            passed = np.unpackbits(arrays["passed"], count=shown.size).reshape(shown.shape).astype(bool)
            background = np.unpackbits(arrays["background"], count=ELEVATION_CELLS * AZIMUTH_CELLS)
            empty = _Observing(header, (1, 1, 1), voxel_m)
            seen = background.reshape(ELEVATION_CELLS, AZIMUTH_CELLS).astype(bool)
            return ObservedSpace(empty.volume_from_world, empty.size_m, voxel_m, np.asarray(shown) > 0, passed, seen)
    return None


def cache_space(header: SceneHeader, space: ObservedSpace) -> None:
    """Store a scene's observed space in the user's cache folder, where that can be written."""
    arrays = {"passed": np.packbits(space.passed), "background": np.packbits(space.background)}
    store_in_cache(_file(header), arrays)


def store_in_cache(file: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Store what was computed of a scene in the user's cache folder, where that can be written, and delete the oldest."""
    with suppress(OutputError, OSError):
        with partial_file(file) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, **arrays)
        for old in sorted(file.parent.glob("*.npz"), key=lambda path: path.stat().st_mtime)[:-MAX_CACHED_SCENES]:
            old.unlink(missing_ok=True)


def cache_file(header: SceneHeader, kind: str, *settings: int | str) -> Path:
    """Return the file in the user's cache folder for what was computed of a scene with these settings."""
    about = json.dumps([SPACE_VERSION, *settings, header.training, header.volume], sort_keys=True, default=str)
    identity = f"{about} {weights_hash(header.path)}"
    return cache_folder() / kind / f"{hashlib.sha256(identity.encode()).hexdigest()}.npz"


def cached_arrays(header: SceneHeader, kind: str, *settings: int | str) -> tuple[Path | None, dict[str, NDArray[Any]]]:
    """Return the `cache_file` of a scene, None for one that is not on disk, and its arrays, none of a missing or broken file."""
    file, arrays = None, {}
    with suppress(OSError, OutputError):
        file = cache_file(header, kind, *settings)
        arrays = read_arrays(file, OutputError)
    return file, arrays


def _file(header: SceneHeader) -> Path:
    return cache_file(header, "observed", IMAGE_COLUMNS, SWEEP_BEAMS, MAX_FRAMES_PER_SENSOR)
