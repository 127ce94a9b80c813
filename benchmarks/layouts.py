"""The same street trained from each layout of logs, and through other lenses: held-out metrics, three seeds each.

python benchmarks/layouts.py FOLDER [--steps 300] [--seeds 3] [--first N] [--json FILE] [NAME...]

FOLDER/logs/NAME is the street's recording in a layout (`layout_logs`), made where it is not there. Each is trained and evaluated
by `unisim train` and `unisim eval`, in processes of their own; what FOLDER holds of an earlier run is not done again.
``--first N`` trains nothing to its end: it prints the first N losses from each layout, which tell a difference within seconds.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from layout_logs.crossed import crossed_psnr
from layout_logs.kitti_log import write_kitti
from layout_logs.nuscenes_log import write_nuscenes
from layout_logs.recording import Recording, Size, make_recording, write_ncore, write_pandaset

from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.lenses.lens import Lens
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole

LENSES: dict[str, Lens] = {
    "distorted": OpenCVPinhole(-0.25, 0.06, 0.001, -0.002),
    "fisheye": OpenCVFisheye(0.05, -0.01, 0.002, -0.001, 100.0),
}
"""Of the same focal length in pixels, so that all images are as fine in their middles."""
METRICS: dict[str, tuple[str, str, Callable[[float], str]]] = {
    "PSNR, dB": ("camera", "psnr_db", lambda value: f"{value:.2f}"),
    "SSIM": ("camera", "ssim", lambda value: f"{value:.3f}"),
    "LiDAR median, cm": ("lidar", "depth_median_m", lambda value: f"{100 * value:.2f}"),
    "90th percentile, m": ("lidar", "depth_p90_m", lambda value: f"{value:.2f}"),
    "drops right": ("lidar", "drop_accuracy", lambda value: f"{value:.3f}"),
    "intensity RMSE": ("lidar", "intensity_rmse", lambda value: f"{value:.3f}"),
}


@dataclass(frozen=True)
class Case:
    """A log that is trained: how it is written, through which lens it was recorded, and where it lies below its folder."""

    write: Callable[[Recording, Path], Path]
    lens: str = ""
    inside: str = ""

    def log(self, folder: Path) -> Path:
        """The path that opens the log."""
        return folder / self.inside


CASES = {
    "pandaset": Case(write_pandaset),
    "ncore": Case(write_ncore),
    "kitti": Case(write_kitti, inside="2011_09_26_drive_0001_sync"),
    "nuscenes": Case(write_nuscenes),
    "distorted": Case(write_ncore, "distorted"),
    "fisheye": Case(write_ncore, "fisheye"),
}


def write_logs(folder: Path, size: Size, names: tuple[str, ...]) -> dict[str, Path]:
    """Write the logs that are not there yet; gives the paths that open them."""
    recordings: dict[str, Recording] = {}
    for name in names:
        case, path = CASES[name], folder / "logs" / name
        if path.exists():
            continue
        if case.lens not in recordings:
            plain = recordings.setdefault("", make_recording(size))
            recordings[case.lens] = plain.with_lens(LENSES[case.lens]) if case.lens else plain
        recording = recordings[case.lens]
        recording.draw()
        partial = folder / "partial"
        subprocess.run(["rm", "-rf", str(partial)], check=True)
        partial.mkdir(parents=True)
        case.write(recording, partial / name)
        path.parent.mkdir(exist_ok=True)
        (partial / name).rename(path)
    return {name: CASES[name].log(folder / "logs" / name) for name in names}


def first_losses(log_path: Path, steps: int, first: int, seed: int, preset: str) -> list[dict[str, float]]:
    """What the first steps of a training measure; all of them are planned for the same length."""
    from unisim_blender.core.prepare.selection import beam_lidars, select_frames
    from unisim_blender.core.training.config import TrainConfig
    from unisim_blender.core.training.trainer import Trainer

    log = open_log(log_path)
    frames = select_frames("::2", log.drive.frames)
    config = TrainConfig(tuple(log.drive.cameras), beam_lidars(log), frames, preset=preset, iterations=steps, seed=seed)
    trainer = Trainer(log, config)
    return [dict(trainer.step()) for _ in range(first)]


def measured(folder: Path, name: str, log: Path, seed: int, steps: int, preset: str) -> dict[str, Any]:
    """Train a seed, evaluate the frames that it did not see, and return the metrics."""
    scene, out = folder / "trained" / f"{name}-{seed}", folder / "evaluated" / f"{name}-{seed}"
    unisim = [sys.executable, "-m", "unisim_blender"]
    if not (scene / "scene.json").exists():
        more = ["--resume"] if (scene / "checkpoint.safetensors").exists() else []
        options = ["--cameras", "all", "--iterations", str(steps), "--seed", str(seed), "--preset", preset, "--quiet"]
        subprocess.run([*unisim, "train", str(log), "--out", str(scene), *options, *more], check=True)
    if not (out / "metrics.json").exists():
        subprocess.run([*unisim, "eval", str(scene), str(log), "--out", str(out)], check=True)
    found: dict[str, Any] = json.loads((out / "metrics.json").read_text())
    return found


def in_words(values: list[float], written: Callable[[float], str]) -> str:
    """Mean and, of several, the least and the greatest."""
    mean = written(float(np.mean(values)))
    return mean if len(values) < 2 else f"{mean} ({written(min(values))} to {written(max(values))})"


def table(results: dict[str, list[dict[str, Any]]]) -> str:
    """The metrics of all seeds as a table, a row for each log."""
    lines = ["| log | " + " | ".join(METRICS) + " |", "|---" * (len(METRICS) + 1) + "|"]
    for name, found in results.items():
        cells = [in_words([one[kind][key] for one in found], written) for kind, key, written in METRICS.values()]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def crossed(folder: Path, logs: dict[str, Path], seeds: int, lens: str) -> dict[str, list[float]]:
    """PSNR where both cameras look, of scenes trained through one and rendered through the other, a number for each seed."""
    both = {"pinhole": logs["ncore"], lens: logs[lens]}
    scenes = {"pinhole": "ncore", lens: lens}
    found: dict[str, list[float]] = {}
    for trained, rendered in (("pinhole", "pinhole"), (lens, "pinhole"), (lens, lens), ("pinhole", lens)):
        other = both[lens if rendered == "pinhole" else "pinhole"]
        found[f"{trained} as {rendered}"] = [
            crossed_psnr(folder / "trained" / f"{scenes[trained]}-{seed}", both[trained], both[rendered], other)
            for seed in range(seeds)
        ]
    return found


@click.command()
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.argument("names", nargs=-1, type=click.Choice(list(CASES)))
@click.option("--steps", default=300, show_default=True, help="Of each training.")
@click.option("--seeds", default=3, show_default=True, help="Trainings of each log.")
@click.option("--first", type=int, help="Print the first losses alone.")
@click.option("--preset", default="small", show_default=True)
@click.option("--frames", default=Size.frames, show_default=True)
@click.option("--width", default=Size.width, show_default=True)
@click.option("--height", default=Size.height, show_default=True)
@click.option("--json", "file", type=click.Path(dir_okay=False, path_type=Path), help="Every metric of every seed.")
def main(
    folder: Path, names: tuple[str, ...], steps: int, seeds: int, first: int | None, preset: str, frames: int,
    width: int, height: int, file: Path | None,
) -> None:  # fmt: skip
    """Train the street from the logs NAMES, or from all."""
    size = replace(Size(), frames=frames, width=width, height=height)
    logs = write_logs(folder, size, names or tuple(CASES))
    if first is not None:
        for name, log in logs.items():
            click.echo(name)
            for number, losses in enumerate(first_losses(log, steps, first, 0, preset)):
                click.echo(f"  {number}: " + " ".join(f"{key} {value:.6g}" for key, value in losses.items()))
        return
    results: dict[str, list[dict[str, Any]]] = {name: [] for name in logs}
    for seed in range(seeds):  # all logs with one seed come before the next seed: an early look compares them
        for name, log in logs.items():
            results[name].append(measured(folder, name, log, seed, steps, preset))
            one = results[name][-1]
            click.echo(
                f"{name}, seed {seed}: {one['camera']['psnr_db']:.2f} dB, {one['lidar']['depth_median_m']:.4f} m"
            )
    click.echo(table(results))
    through = {lens: crossed(folder, logs, seeds, lens) for lens in LENSES if lens in logs and "ncore" in logs}
    for lens, found in through.items():
        click.echo(f"\n| {lens}: trained and rendered | PSNR where both look, dB |\n|---|---|")
        for what, values in found.items():
            click.echo(f"| {what} | {in_words(values, lambda value: f'{value:.2f}')} |")
    if file is not None:
        about = {"steps": steps, "preset": preset, "frames": frames, "width": width, "height": height}
        summary = {
            name: [{kind: one[kind] for kind in ("camera", "lidar")} for one in found]
            for name, found in results.items()
        }
        file.write_text(json.dumps({**about, "logs": summary, "lenses": through}, indent=1))


if __name__ == "__main__":
    main()
