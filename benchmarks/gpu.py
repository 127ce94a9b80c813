"""One command for a GPU: kernels beside torch, trainings at full size, times and profiles, as one JSON
within ten minutes.

python benchmarks/gpu.py --out FOLDER [--device cuda] [--budget-s 600] [--size 1920x1080] [--seconds 60] [--frames 8]

It takes the working tree as it is, needs no network and no data, builds the native library where none runs, and makes a
street of its own. Each stage is a process with a share of the budget; one that fails or takes too long leaves its
traceback and what it had found so far, and the next begins. FOLDER/gpu.json is written anew after each. Exit status 1:
a stage failed, or a kernel disagreed with torch. To try it without a GPU:

python benchmarks/gpu.py --out FOLDER --device cpu --size 160x96 --seconds 5 \\
    --frames 4 --samples 300
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

ROOT = Path(__file__).resolve().parents[1]
# beside this file lie modules with common names
sys.path[:] = [str(ROOT), *(path for path in sys.path if path != str(ROOT / "benchmarks"))]

from benchmarks.gpu_stages.settings import Settings, write_json  # noqa: E402

SHARES = {
    "machine": 20, "native": 60, "street": 120, "kernels": 150, "train": 40, "tracer": 40, "times": 60, "profile": 40,
}  # fmt: skip
"""Seconds that a stage may take where the budget is `FULL_S`; a training may take what it trains for besides,
and the kernels a minute in which NVRTC compiles them."""
FULL_S = 600.0
SPARE_S = 15.0
"""Of a full budget, for what lies between stages: a command that is ended from outside leaves less."""


class Run:
    """A run's stages and its JSON."""

    def __init__(self, settings: Settings, budget_s: float) -> None:
        self.settings, self.scale = settings, budget_s / FULL_S
        self.begun, self.until = time.monotonic(), time.monotonic() + budget_s - SPARE_S * self.scale
        self.file = Path(settings.out) / "gpu.json"
        self.values: dict[str, Any] = {"settings": vars(settings), "budget_s": budget_s, "failed": [], "stages": {}}

    def start(self, name: str) -> tuple[subprocess.Popen[bytes], Path, float]:
        """Start a stage; return its process, where it writes, and when it is ended."""
        kind = name.partition("-")[0]
        share_s = SHARES[kind] * self.scale + (self.settings.seconds if kind == "train" else 0)
        limit_s = max(min(share_s, self.until - time.monotonic()), 0.0)
        file = Path(self.settings.work) / f"{name}.json"
        told = replace(self.settings, limit_s=limit_s - min(3.0, 0.1 * limit_s)).to_json()
        command = [sys.executable, "-m", "benchmarks.gpu_stages", name, told, str(file)]
        with (Path(self.settings.work) / f"{name}.log").open("wb") as log:
            process = subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=subprocess.STDOUT)
        return process, file, time.monotonic() + limit_s

    def finish(self, name: str, started: tuple[subprocess.Popen[bytes], Path, float]) -> bool:
        """Wait for a stage, end it when its time is over, and take what it found into the JSON; return
        whether all went well."""
        process, file, until = started
        begun, late = time.monotonic(), False
        try:
            process.wait(max(until - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:
            late = True
            process.kill()
            process.wait()
        found: dict[str, Any] = read_json(file)
        if late:
            found["error"] = f"it was ended when its time was over\n{tail_of(file.with_suffix('.log'))}"
        elif process.returncode and "error" not in found and "errors" not in found:
            found["error"] = f"it ended with {process.returncode}\n{tail_of(file.with_suffix('.log'))}"
        well = process.returncode == 0 and not late
        if not well:
            self.values["failed"].append(name)
        self.values["stages"][name] = {"waited_s": round(time.monotonic() - begun, 1), "ok": well, **found}
        self.values["whole_s"] = round(time.monotonic() - self.begun, 1)
        write_json(self.file, self.values)
        click.echo(f"{self.values['whole_s']:6.1f} s  {name:14} {'ok' if well else 'FAILED':6}  {summary(name, found)}")
        return well

    def stage(self, name: str) -> bool:
        """Run a stage; return whether all went well."""
        return self.finish(name, self.start(name))


def read_json(file: Path) -> dict[str, Any]:
    """Return what a stage has written; nothing where it did not come to that."""
    try:
        found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        return found
    except (OSError, ValueError):
        return {}


def tail_of(file: Path, characters: int = 3000) -> str:
    """Return the end of a stage's output."""
    return file.read_text(encoding="utf-8", errors="replace")[-characters:] if file.exists() else ""


def summary(name: str, found: dict[str, Any]) -> str:
    """Return one line of what a stage found."""
    kind = name.partition("-")[0]
    said = ""
    if kind == "machine" and "torch" in found:
        said = f"{found.get('gpu', found['device'])}, Python {found['python']}, torch {found['torch']}, "
        said += f"numpy {found['numpy']}"
    elif kind == "native":
        said = f"{found.get('variant', 'none')}, {'built now' if found.get('built') else 'not built now'}"
    elif kind == "street" and "seconds" in found:
        said = f"{found['frames']} frames of {found['size'][0]}x{found['size'][1]} in {found['seconds']} s"
    elif kind == "kernels" and "cases" in found:
        worst = max((e.get("max_rel", 0.0) for of in found["cases"].values() for e in of.values()), default=0.0)
        said = f"{len(found['cases'])} cases, {len(found['wrong'])} out of bound, worst {worst:.1e}, not launched: "
        said += ", ".join(found["not_launched"]) or "none"
    elif kind == "train" and "steps" in found:
        said = f"{found['steps']} steps, {found.get('steps_per_s', 0):.1f} a second, loss {found['last']['loss']:.3f}, "
        said += f"held out {found.get('psnr_db')} dB"
    elif kind == "tracer" and "images" in found:
        said = ", ".join(f"{width} wide {of['ms']:.1f} ms" for width, of in found["images"].items())
    elif kind == "times" and "times" in found:
        said = "; ".join(
            f"{what} " + ", ".join(f"{name} {of[name]['ms']:.0f} ms" for name in ("kernels", "torch") if name in of)
            for what, of in found["times"].items()
        )
    elif kind == "profile":
        parts = [
            f"{what}: {found[what]['operations'][0]['name'][:40]} first" for what in ("steps", "image") if what in found
        ]
        said = ", ".join(parts)
    lines = [str(found["error"]).strip().splitlines()[-1]] if found.get("error") else []
    lines += [f"{what}: {trace.strip().splitlines()[-1]}" for what, trace in found.get("errors", {}).items()]
    return " | ".join(part[:300] for part in (said, found.get("skipped", ""), *lines) if part)


def run_all(run: Run, presets: tuple[str, ...]) -> None:
    """Run all stages. The street is made on the CPU while the GPU is busy with kernels."""
    run.stage("machine")
    run.stage("native")
    street = run.start("street")
    run.stage("kernels")
    made = run.finish("street", street)
    trained = [preset for preset in presets if made and run.stage(f"train-{preset}")]
    for kind in ("tracer", "times", "profile"):
        for preset in trained:
            run.stage(f"{kind}-{preset}")


def size_of(_context: Any, _option: Any, value: str) -> tuple[int, int]:
    """Return a size of images, WIDTHxHEIGHT, as two numbers."""
    width, _, height = value.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise click.BadParameter("a size is WIDTHxHEIGHT")
    return int(width), int(height)


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="Folder of gpu.json and of the profiler's traces."
)
@click.option("--device", default="cuda", show_default=True)
@click.option(
    "--budget-s", default=FULL_S, show_default=True, help="Seconds in all; what is not done by then is left out."
)
@click.option(
    "--size", default="1920x1080", show_default=True, callback=size_of, help="Of the street's images, pixels."
)
@click.option("--seconds", default=60.0, show_default=True, help="Of each training.")
@click.option(
    "--frames", type=click.IntRange(4), default=8, show_default=True, help="Of the street; even ones are learnt from."
)
@click.option("--presets", default="small,hd-gpu", show_default=True, help="What is trained.")
@click.option("--samples", default=200_000, show_default=True, help="Of each comparison of a kernel.")
@click.option("--rounds", default=5, show_default=True, help="Of each time, at most.")
def main(
    out: Path, device: str, budget_s: float, size: tuple[int, int], seconds: float, frames: int, presets: str,
    samples: int,
    rounds: int,
) -> None:  # fmt: skip
    """Run all stages; exit with 1 where one failed."""
    out.mkdir(parents=True, exist_ok=True)
    work = tempfile.mkdtemp(prefix="unisim-gpu-")
    settings = Settings(device, size, frames, seconds, samples, rounds, work, str(out.resolve()))
    run = Run(settings, budget_s)
    try:
        run_all(run, tuple(name.strip() for name in presets.split(",")))
    finally:
        shutil.rmtree(work, ignore_errors=True)
    failed = run.values["failed"]
    click.echo(f"{run.file}: {', '.join(failed) + ' failed' if failed else 'all well'}")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
