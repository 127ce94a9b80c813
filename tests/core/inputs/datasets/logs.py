"""How logs are read through, and what is checked of one that is read: everything in it is finite and of its kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inputs.promise import Property, Reader
from inputs.strategies import gone, inputs_of
from unisim_blender.core.cli.commands.info import describe_log, lines_of
from unisim_blender.core.data.log import Log, Sweep, SweepGrid, extras_of
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import FloatArray, Trajectory

UNIT = 1e-5
MOST_READ = 2
"""Of each sensor's images and sweeps."""


def read_log(path: Path) -> object:
    """Open a log, read through it and check what it gives."""
    return read_through(open_log(path))


def read_through(log: Log) -> object:
    """Read through a log and check what it gives."""
    check_drive(log)
    lines_of(describe_log(log))
    for name, camera in log.drive.cameras.items():
        size = camera.model.height, camera.model.width
        mask = extras_of(log).own_vehicle_mask(name)
        assert mask is None or (mask.shape == size and mask.dtype == bool)
        for frame in log.image_frames(name)[:MOST_READ]:
            image = log.image(name, frame)
            assert image.shape == (*size, 3) and image.dtype == np.uint8, f"{name}: an image of {image.shape}"
    for name, lidar in log.drive.lidars.items():
        for frame in log.sweep_frames(name)[:MOST_READ]:
            check_sweep(log.sweep_grid(name, frame) if lidar.model.beams else log.sweep(name, frame))
    return log


def check_drive(log: Log) -> None:
    """Check that a drive's times, trajectories and boxes are finite."""
    drive = log.drive
    times = np.array(list(drive.time_s.values()))
    finite(times, drive.world_origin)
    tracks: list[tuple[Trajectory, FloatArray]] = [(drive.world_from_ego, times)]
    for camera in drive.cameras.values():
        tracks.append((camera.world_from_camera, np.array(list(camera.time_s.values()))))
        model = camera.model
        finite(np.array([model.fx, model.fy, model.cx, model.cy, model.shutter.duration_s, model.shutter.reference]))
    for lidar in drive.lidars.values():
        tracks.append((lidar.world_from_lidar, np.array(list(lidar.time_s.values()))))
        finite(lidar.model.elevation_rad, lidar.model.azimuth_offset_rad)
    for actor in drive.actors.values():
        tracks.append((actor.world_from_actor, times))
        finite(actor.size_m)
        assert (actor.size_m > 0).all(), f"a box of {actor.size_m}"
    for track, at in tracks:
        poses = track.at(at)
        finite(poses)
        turned = poses[..., :3, :3]
        assert np.abs(turned @ turned.swapaxes(-1, -2) - np.eye(3)).max(initial=0) < UNIT, "a pose is not rigid"


def check_sweep(sweep: Sweep | SweepGrid) -> None:
    """Check that a sweep is finite and its directions are of length 1."""
    if isinstance(sweep, Sweep):
        finite(sweep.points, sweep.origins, sweep.time_s, sweep.intensity)
        if sweep.drops is not None:
            finite(sweep.drops.origins, sweep.drops.time_s)
            unit(sweep.drops.directions)
        return
    finite(sweep.origins, sweep.time_s, sweep.depth_m, sweep.intensity)
    unit(sweep.directions)
    assert (sweep.depth_m >= 0).all() and not (sweep.returned & sweep.blocked).any()


def finite(*arrays: NDArray[Any]) -> None:
    """Check that all numbers of arrays are."""
    for array in arrays:
        assert np.isfinite(array).all(), f"not finite: {np.asarray(array)[~np.isfinite(array)][:3]}"


def unit(directions: FloatArray) -> None:
    """Check that vectors (..., 3) are of length 1."""
    assert np.abs(np.linalg.norm(directions, axis=-1) - 1).max(initial=0) < UNIT, "a direction is none"


def layout(
    write: Callable[[Path], Path],
    views: Callable[[str], Sequence[str]],
    kept: Callable[[str], bool] = lambda name: True,
    read: Callable[[Path], object] = read_log,
) -> Property:
    """Return the property of a layout's reader. ``write`` fills a folder with a log and returns its path; ``views`` are the views
    of a file by its name; faults are those of the files that are ``kept``."""

    def make(folder: Path) -> Reader:
        path = write(folder)
        whole = files_of(folder, kept)
        drawn = inputs_of(whole, {name: views(name) for name in whole})
        # one in a few is missing
        inputs = drawn | drawn | drawn | drawn | gone(whole)
        return Reader(folder, whole, lambda: read(path), inputs, (str(folder),))

    return Property(make)


def files_of(folder: Path, kept: Callable[[str], bool]) -> dict[str, bytes]:
    """Return the files below a folder by their names."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    names = {path.relative_to(folder).as_posix(): path for path in paths}
    return {name: path.read_bytes() for name, path in names.items() if kept(name)}
