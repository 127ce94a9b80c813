"""Writes a street's recorded drive as a log in PandaSet's layout, frames in parallel; equal recipes
give equal bytes."""

from __future__ import annotations

import json
import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from unisim_blender.core.errors import LogError, OutputError
from unisim_blender.core.files import holds_out, remove_partial_files, write_file
from unisim_blender.core.formats.pandaset.sensors import PANDAR64
from unisim_blender.core.formats.pandaset.write import PandasetWriter
from unisim_blender.core.processes import THREAD_VARIABLES, end_with_parent
from unisim_blender.core.progress import Bar
from unisim_blender.core.sensors.frames import LidarFrame

from .drawing.path_tracer import check_blender, draw_log
from .street import RECIPE_FILE, Street, load_street, recipe_document
from .truth import truth_camera, truth_lidar

_worker: tuple[Street, PandasetWriter] | None = None


@holds_out
def write_log(street: Street, out: Path, jobs: int, progress: bool = True) -> None:
    """Write the log to ``out`` by ``jobs`` processes. A folder that holds a part of the same street is completed.

    Cycles draws its images in a process of its own, those that are not there yet. Raises `OutputError` where ``out``
    holds anything else, `ModuleNotFoundError` where Cycles is wanted and Blender's module is not installed.
    """
    if street.recipe.engine == "cycles":
        check_blender()
    _claim(street, out)
    remove_partial_files(out)
    with _single_threaded():
        context = multiprocessing.get_context("spawn")  # a forked child would keep the parent's threaded BLAS
        with ProcessPoolExecutor(jobs, context, _start, (out,)) as pool:
            what = "frames" if street.recipe.engine == "exact" else "sweeps"
            tasks = [pool.submit(_write_frame, frame) for frame in street.drive.frames]
            try:
                for task in Bar(
                    as_completed(tasks),
                    total=len(tasks),
                    desc=what,
                    unit="frame",
                    disable=not progress,
                ):
                    task.result()
            except BaseException:
                pool.shutdown(wait=True, cancel_futures=True)
                raise
    if street.recipe.engine == "cycles":
        draw_log(out, progress)
    PandasetWriter(out, street.drive).finish()


def noisy(frame: LidarFrame, street: Street, number: int) -> LidarFrame:
    """The sweep as recorded: ranges with the recipe's noise, drawn from the seed and the frame's number."""
    rng = np.random.default_rng([street.recipe.seed, number, 64])
    noise = rng.normal(0.0, 1.0, frame.depth_m.shape) * street.recipe.range_noise_m
    return replace(frame, depth_m=np.where(frame.returned, frame.depth_m + noise, 0.0).astype(np.float32))


def _claim(street: Street, out: Path) -> None:
    if out.exists() and not out.is_dir():
        raise OutputError(f"{out}: is no folder")
    if out.is_dir() and any(out.iterdir()):
        try:
            same = load_street(out).recipe == street.recipe
        except LogError as error:
            raise OutputError(f"{out}: is not empty and holds no street") from error
        if not same:
            raise OutputError(f"{out}: holds another street, of seed {load_street(out).recipe.seed}")
    write_file(out / RECIPE_FILE, (json.dumps(recipe_document(street.recipe), indent=2) + "\n").encode())


@contextmanager
def _single_threaded() -> Iterator[None]:
    """Let processes started meanwhile use one thread each: as fast, and the same bits whatever the machine."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _start(out: Path) -> None:
    global _worker
    end_with_parent()
    street = load_street(out)
    _worker = street, PandasetWriter(out, street.drive)


def _write_frame(frame: int) -> None:
    assert _worker is not None
    street, writer = _worker
    for name in street.drive.cameras if street.recipe.engine == "exact" else ():
        rgb = truth_camera(street, street.drive, name, frame).rgb
        writer.write_image(name, frame, np.rint(rgb * 255).astype(np.uint8))
    sweep = noisy(truth_lidar(street, street.drive, PANDAR64, frame), street, frame)
    writer.write_sweep(frame, {PANDAR64: sweep})
    writer.write_cuboids(frame)
