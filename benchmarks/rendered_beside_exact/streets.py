"""The streets: small logs of them with a frame every `PERIOD_S`, and the scenes that are trained on these."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from unisim_blender.core.files import write_file
from unisim_blender.core.formats.pandaset.sensors import PANDAR64
from unisim_blender.core.formats.pandaset.write import PandasetWriter
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.json_file import json_bytes
from unisim_blender.core.training.config import TrainConfig
from unisim_blender.core.training.load_or_train import load_or_train
from unisim_blender.core.world.drive import Drive
from unisim_street.layout import FRAME_S
from unisim_street.street import RECIPE_FILE, Street, build_street, recipe_document
from unisim_street.truth import truth_camera, truth_lidar
from unisim_street.write import noisy

CAMERA = "front_camera"
FRAMES, EVERY = 89, 2
"""Frames of a street's drive, and every how many is recorded."""
PERIOD_S = EVERY * FRAME_S
WIDTH, HEIGHT = 320, 180
SAMPLES = 1
"""Rays along an edge of a pixel, of the log's images and of the loop's exact ones."""


def street_of_seed(seed: int) -> Street:
    """Return a street."""
    return build_street(seed, FRAMES, WIDTH, HEIGHT, (CAMERA,))


def log_folder(folder: Path, seed: int) -> Path:
    """Return where a street's log lies."""
    return folder / f"street-{seed}" / "log"


def scene_folder(folder: Path, seed: int) -> Path:
    """Return where a street's trained scene lies."""
    return folder / f"street-{seed}" / "scene"


def write_log(folder: Path, seed: int) -> Path:
    """Write a street's log where it is missing, with the noise of a recorded sweep; its folder."""
    out = log_folder(folder, seed)
    street = street_of_seed(seed)
    drive = sparse(street.drive, EVERY)
    write_file(out / RECIPE_FILE, json_bytes(recipe_document(street.recipe)))
    writer = PandasetWriter(out, drive)
    for frame in tqdm(drive.frames, desc=f"street {seed}", unit="frame"):
        if writer.sweep_path(frame).is_file():  # it is written last
            continue
        rgb = truth_camera(street, drive, CAMERA, frame, samples=SAMPLES).rgb
        writer.write_image(CAMERA, frame, np.rint(rgb * 255).astype(np.uint8))
        writer.write_cuboids(frame)
        writer.write_sweep(frame, {PANDAR64: noisy(truth_lidar(street, drive, PANDAR64, frame), street, frame)})
    writer.finish()
    return out


def train_scene(folder: Path, seed: int, preset: str, minutes: float | None, iterations: int | None) -> Path:
    """Train a street's scene on all frames of its log, for a time or for so many steps, where it is missing; its folder. An
    interrupted training goes on."""
    out = scene_folder(folder, seed)
    log = open_log(log_folder(folder, seed))
    config = TrainConfig((CAMERA,), (PANDAR64,), log.drive.frames, preset=preset, iterations=iterations)
    load_or_train(log, replace(config, minutes=minutes) if iterations is None else config, out)
    return out


def sparse(drive: Drive, every: int) -> Drive:
    """Return the drive with one frame of so many, numbered anew."""

    def kept(time_s: dict[int, float]) -> dict[int, float]:
        return {number: time_s[frame] for number, frame in enumerate(drive.frames[::every])}

    return replace(
        drive,
        frames=tuple(range(len(drive.frames[::every]))),
        time_s=kept(drive.time_s),
        cameras={name: replace(one, time_s=kept(one.time_s)) for name, one in drive.cameras.items()},
        lidars={name: replace(one, time_s=kept(one.time_s)) for name, one in drive.lidars.items()},
    )
