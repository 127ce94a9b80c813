"""How a scene's detail depends on how long and how winding its drive is: PSNR and LiDAR errors along streets of several shapes.

python benchmarks/long_street.py FOLDER [--only NAME] [--preset tiny] [--steps-per-m 2]

Each street is drawn small, written as NCore to FOLDER/NAME/log and trained for as many steps a metre as the others. Frames that
were not trained on are compared with what was recorded; means are printed of each tenth of the drive, and of all. What is there
already is not made again, but for a scene's evaluation.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from unisim_blender.core.formats.ncore.write import NcoreWriter
from unisim_blender.core.formats.pandaset.sensors import PANDAR64
from unisim_street.layout import FRAME_S
from unisim_street.street import build_street
from unisim_street.truth import truth_camera, truth_lidar
from unisim_street.write import noisy

SPEED_M_S = 40.0
CASES: dict[str, tuple[float, tuple[float, ...]]] = {
    "short": (120.0, ()),
    "turn": (300.0, (90.0,)),
    "km": (1000.0, ()),
    "km-turn": (1000.0, (90.0,)),
}
"""Metres of a drive, and the street's bends."""
WIDTH, HEIGHT = 160, 90
EVERY_BEAM, COLUMNS = 2, 450
COMPARED = 3, 8
"""Of the odd frames, on which nothing is trained, those from the first number on by the second are drawn and compared."""
PARTS = 10
SWEEP = ("depth_median_m", "drop_accuracy")


def draw(metres: float, turns: tuple[float, ...], out: Path) -> None:
    """Write a street's log: one camera, and a LiDAR with half of the beams and a quarter of the columns."""
    street = build_street(
        0, round(metres / SPEED_M_S / FRAME_S) + 1, WIDTH, HEIGHT, speed_m_s=SPEED_M_S, turns_deg=turns
    )
    lidar = street.drive.lidars[PANDAR64]
    table = lidar.model
    coarse = replace(
        table, elevation_rad=table.elevation_rad[::EVERY_BEAM], azimuth_offset_rad=table.azimuth_offset_rad[::EVERY_BEAM],
        columns=COLUMNS,
    )  # fmt: skip
    drive = replace(street.drive, lidars={PANDAR64: replace(lidar, model=coarse)})
    (name,) = drive.cameras
    with NcoreWriter(out, drive) as writer:
        for frame in drive.frames:
            if frame % 2 and frame % COMPARED[1] != COMPARED[0]:
                continue
            writer.write_image(
                name, frame, np.rint(truth_camera(street, drive, name, frame).rgb * 255).astype(np.uint8)
            )
            writer.write_sweep(PANDAR64, frame, noisy(truth_lidar(street, drive, PANDAR64, frame), street, frame))
            if frame % 20 == 0:
                click.echo(f"{out.parent.name}: {frame} of {len(drive.frames)} frames", err=True)


def unisim(*arguments: str) -> float:
    """Run the command, and return how many seconds of processors it took."""
    before = os.times()
    subprocess.run([sys.executable, "-m", "unisim_blender", *arguments], check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def along(per_frame: list[dict[str, Any]], frames: int) -> list[tuple[float, float, float]]:
    """Return of each tenth of the drive, and of all: PSNR outside of actors, the median LiDAR error in metres, and how many rays
    are right about returning; means over its frames, nan where it has none."""
    rows = []
    for part in [*range(PARTS), None]:
        there = [one for one in per_frame if part is None or one["frame"] * PARTS // frames == part]
        images = [image["outside_actors"] for one in there for image in one["camera"].values()]
        sweeps = [sweep for one in there for sweep in one["lidar"].values()]
        values = [[one["psnr_db"] for one in images], *([one[key] for one in sweeps] for key in SWEEP)]
        found = [float(np.mean(known)) if (known := [x for x in of if x is not None]) else np.nan for of in values]
        rows.append((found[0], found[1], found[2]))
    return rows


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--only", multiple=True, type=click.Choice(list(CASES)), help="Of the streets.")
@click.option("--preset", default="tiny", show_default=True)
@click.option("--steps-per-m", default=2.0, show_default=True)
@click.option("--scene", default="scene", show_default=True, help="Name of the scenes' folders.")
@click.option("--drawn", is_flag=True, help="Draw only.")
def main(folder: Path, only: tuple[str, ...], preset: str, steps_per_m: float, scene: str, drawn: bool) -> None:
    """Draw, train and compare in FOLDER."""
    for name in only or CASES:
        metres, turns = CASES[name]
        log, made, out = folder / name / "log", folder / name / scene, folder / name / f"{scene}-eval"
        if not log.exists():
            draw(metres, turns, log)
        if drawn:
            continue
        steps, cpu_s, begun = round(metres * steps_per_m), float("nan"), time.perf_counter()
        if not (made / "scene.json").exists():
            cpu_s = unisim(
                "train", str(log), "--out", str(made), "--preset", preset, "--iterations", str(steps), "--quiet"
            )
        wall_s = time.perf_counter() - begun
        unisim("eval", str(made), str(log), "--out", str(out), "--frames", "{}::{}".format(*COMPARED))
        document = json.loads((out / "metrics.json").read_text())
        volume = json.loads((made / "scene.json").read_text())
        sizes = volume["volume"]["size_m"]
        count = round(metres / SPEED_M_S / FRAME_S) + 1
        click.echo(
            f"{name}: {metres:.0f} m, turns {turns}; {steps} steps, {cpu_s:.0f} s CPU, {wall_s:.0f} s; volume "
            f"{' x '.join(f'{size:.0f}' for size in sizes)} m"
        )
        for number, (psnr, error_m, right) in enumerate(along(document["per_frame"], count)):
            part = f"{number * 100 // PARTS} %" if number < PARTS else "all"
            click.echo(f"  {part:>5}: {psnr:6.2f} dB, {error_m * 100:6.1f} cm, {right:.3f}")


if __name__ == "__main__":
    main()
