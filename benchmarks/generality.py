"""Scenes of streets of many kinds and of drives, all trained and measured alike: a table, worst first.

python -m benchmarks.generality --out FOLDER [--street night:2 ...] [--drive PATH ...] [--preset small ...] [--unisim PATH ...]

Each drive is trained on its even frames and measured on the odd ones: replay (PSNR, SSIM, LiDAR), of streets 2 and 3 m to
the left beside their truth, and with a detector what it recalls beside the path (`unisim eval --shifts`). Several presets, or
commands `unisim` of several versions, stand side by side; drives are then sorted by what the last loses against the first.
The same command goes on where it was cut off.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from unisim_blender.core.progress import Bar

STREETS = ("straight:1", "night:2", "curve:3", "crossing:4", "curve:6", "night:7")
SHIFTED = ("shift-2m", "shift-3m")
COLUMNS = {
    "gain": ("dB above neighbours", "{:+.2f}"),
    "psnr": ("PSNR", "{:.2f}"),
    "ssim": ("SSIM", "{:.3f}"),
    "lidar": ("LiDAR cm", "{:.1f}"),
    "p90": ("p90 cm", "{:.0f}"),
    "shift-2m": ("PSNR at 2 m", "{:.2f}"),
    "shift-3m": ("at 3 m", "{:.2f}"),
    "lost": ("image recall lost a metre, %", "{:.1f}"),
    "lost_truth": ("of it the view's", "{:.1f}"),
}


@dataclass(frozen=True)
class Plan:
    """What is the same for all drives."""

    out: Path
    width: int
    steps: int
    frames: int
    detector: str | None


def command(unisim: str, *arguments: object, log: Path) -> None:
    """Run a command of unisim, its output in a file. Raises `click.ClickException` where it fails."""
    log.parent.mkdir(parents=True, exist_ok=True)
    with open(log, "ab") as file:
        failed = subprocess.run([unisim, *map(str, arguments)], stdout=file, stderr=file).returncode
    if failed:
        raise click.ClickException(
            f"unisim {arguments[0]} failed: {log.read_text(errors='replace').strip().splitlines()[-1]}"
        )


def street_log(unisim: str, street: str, plan: Plan) -> Path:
    """Write the log of a street, KIND:SEED, where it is not there yet."""
    kind, _, seed = street.partition(":")
    log = plan.out / "logs" / f"{kind}-{seed}"
    size = ["--width", plan.width, "--height", round(plan.width * 9 / 16 / 2) * 2, "--frames", plan.frames]
    if not (log / "scenarios").is_dir():
        command(
            unisim,
            "synth",
            log,
            "--kind",
            kind,
            "--seed",
            seed,
            *size,
            "--edits",
            "--quiet",
            log=plan.out / "commands" / log.name,
        )
    return log


def measured(unisim: str, preset: str, log: Path, is_street: bool, plan: Plan, variant: str) -> dict[str, float]:
    """Train and measure one drive where that is not done, and return its row."""
    folder, output = plan.out / variant / log.name, plan.out / "commands" / f"{variant}-{log.name}"
    scene = folder / "scene"
    sizes = ["--width", plan.width]
    if not (scene / "scene.json").is_file():
        resume = ["--resume"] if (scene / "checkpoint.safetensors").is_file() else []
        budget = ["--frames", "::2", "--preset", preset, "--iterations", plan.steps, "--quiet"]
        command(unisim, "train", log, "--out", scene, *sizes, *budget, *resume, log=output)
    replay = document(folder / "replay" / "metrics.json", unisim, ["eval", scene, log, *sizes], output)
    camera, lidar = replay["camera"], replay["lidar"]
    row = {"psnr": camera["psnr_db"], "ssim": camera["ssim"]}
    if (neighbours := camera.get("neighbour_average_psnr_db")) is not None:
        row["gain"] = camera["psnr_db"] - neighbours
    if lidar.get("depth_median_m") is not None:
        row |= {"lidar": 100 * lidar["depth_median_m"], "p90": 100 * lidar["depth_p90_m"]}
    for name in SHIFTED if is_street else ():
        asked = ["eval", "--truth", log, log / "scenarios" / f"{name}.json", "--scene", scene, "--width", plan.width]
        truth = document(folder / name / "metrics.json", unisim, [*asked, "--frames", "1::10"], output)
        row[name] = truth["camera"]["edit"]["psnr_db"]
    if plan.detector is not None:
        asked = ["eval", scene, log, "--shifts", "--detector", plan.detector, *sizes]
        slopes = document(folder / "shifts" / "shifts.json", unisim, asked, output)["lost_per_metre"]
        images: dict[str, Any] = next((rows for title, rows in slopes.items() if title.startswith("camera")), {})
        for name, key in (("scene", "lost"), ("truth", "lost_truth")):
            if name in images and (slope := images[name]["value"]) is not None:
                row[key] = 100 * slope
    return row


def document(path: Path, unisim: str, arguments: list[object], output: Path) -> dict[str, Any]:
    """Return the JSON document that a command writes, which runs where that is not there yet."""
    if not path.is_file():
        command(unisim, *arguments, "--out", path.parent, log=output)
    read: dict[str, Any] = json.loads(path.read_text())
    return read


def table(rows: dict[str, dict[str, dict[str, float]]], variants: list[str]) -> list[str]:
    """Return rows by drive and variant as a table in Markdown, worst first: by the gain over the mean of neighbouring frames, or
    where there are several variants by what the last one's PSNR gains over the first's."""

    def goodness(name: str) -> float:
        first, last = rows[name][variants[0]], rows[name][variants[-1]]
        return first.get("gain", first["psnr"]) if len(variants) == 1 else last["psnr"] - first["psnr"]

    shown = [key for key in COLUMNS if any(key in row for by in rows.values() for row in by.values())]
    lines = ["| drive | " + " | ".join(COLUMNS[key][0] for key in shown) + " |", "|---" * (len(shown) + 1) + "|"]
    for name in sorted(rows, key=goodness):
        cells = [
            " / ".join(
                COLUMNS[key][1].format(row[key]) if key in row else "-" for row in (rows[name][v] for v in variants)
            )
            for key in shown
        ]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120})
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder of logs, scenes and metrics.")
@click.option("--street", "streets", multiple=True, default=STREETS, show_default=True, metavar="KIND:SEED")
@click.option("--drive", "drives", multiple=True, type=click.Path(exists=True, path_type=Path), help="A log.")
@click.option("--preset", "presets", multiple=True, default=("small",), show_default=True)
@click.option(
    "--unisim", "commands", multiple=True, default=(str(Path(sys.executable).parent / "unisim"),), help="The command."
)
@click.option("--steps", default=1200, show_default=True, help="Of each training.")
@click.option("--width", default=480, show_default=True, help="Of the images.")
@click.option("--frames", default=40, show_default=True, help="Of each street.")
@click.option("--detector", metavar="MODULE:FUNCTION", help="See `unisim eval --shifts`.")
def main(
    out: Path, streets: tuple[str, ...], drives: tuple[Path, ...], presets: tuple[str, ...], commands: tuple[str, ...],
    steps: int, width: int, frames: int, detector: str | None,
) -> None:  # fmt: skip
    """Train and measure streets and drives; print a table, worst first."""
    plan = Plan(out, width, steps, frames, detector)
    variants = {f"{number}-{preset}": (unisim, preset) for number, unisim in enumerate(commands) for preset in presets}
    jobs = [(drive, variant) for drive in (*streets, *drives) for variant in variants]
    rows: dict[str, dict[str, dict[str, float]]] = {}
    for drive, variant in Bar(jobs, desc="generality", unit="scene", dynamic_ncols=True):
        unisim, preset = variants[variant]
        log = drive if isinstance(drive, Path) else street_log(unisim, drive, plan)
        rows.setdefault(log.name, {})[variant] = measured(
            unisim, preset, log, not isinstance(drive, Path), plan, variant
        )
        complete = {name: row for name, row in rows.items() if len(row) == len(variants)}
        (out / "table.md").write_text("\n".join(table(complete, list(variants))) + "\n")
    click.echo((out / "table.md").read_text())


if __name__ == "__main__":
    main(prog_name="python -m benchmarks.generality")
