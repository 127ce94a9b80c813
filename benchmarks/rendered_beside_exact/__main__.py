"""The stack of `examples/perception` in the loop on rendered sensors, beside the same loop on exact ones, over many seeds.

python -m benchmarks.rendered_beside_exact WEIGHTS --work FOLDER --out FOLDER [--seeds 20] [--streets 1] [--jobs 1]
python -m benchmarks.rendered_beside_exact WEIGHTS --work FOLDER --out FOLDER --noise 1e-6

Streets have a frame every 0.2 s, and a scene trained on all of them; those that are missing in WORK are written and trained. A
seed decides where and how fast the vehicle starts, when actors come, and what the vehicle ahead does. Both loops of a seed are
in the street's own world. They differ in what the sensors deliver alone. `--noise` tells how far such loops part anyhow, on
other noise of the same exact sensors. Results are kept in OUT, and a run goes on where it was interrupted.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.executors import EXECUTORS
from unisim_blender.core.executors.executor import results_of
from unisim_blender.core.files import write_file
from unisim_blender.core.json_file import json_bytes

from .loops import DURATION_S, EXACT, RENDERED, Loops, Unit
from .streets import train_scene, write_log
from .tables import lines, metrics_of


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120})
@click.argument("weights", type=click.Path(path_type=Path))
@click.option("--work", required=True, type=click.Path(path_type=Path), help="Folder of the streets' logs and scenes.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder of the results.")
@click.option("--seeds", default=20, show_default=True, help="How many, of each street.")
@click.option("--streets", default=1, show_default=True, help="How many, from --first-street on.")
@click.option("--first-street", default=0, show_default=True, help="Its seed.")
@click.option("--minutes", default=10.0, show_default=True, help="Of each training.")
@click.option("--iterations", type=int, help="Of each training, in place of minutes.")
@click.option("--preset", default="compact", show_default=True, help="Of each training.")
@click.option("--quality", default="fast", show_default=True)
@click.option(
    "--duration", "duration_s", default=DURATION_S, show_default=True, help="Seconds of a rollout, 8 at most."
)
@click.option(
    "--noise",
    "noise_m",
    type=click.FloatRange(min=0, min_open=True),
    help="Metres. Exact sensors with so much noise of ranges in place of rendered ones: the loop's own sensitivity.",
)
@click.option(
    "--draws",
    type=click.IntRange(1, 2),
    default=1,
    show_default=True,
    help="With --noise: 1 is compared with exact sensors without noise, 2 with each other.",
)
@click.option("--jobs", default=1, show_default=True, help="Processes, each with a street of its own open.")
def main(
    weights: Path, work: Path, out: Path, seeds: int, streets: int, first_street: int, minutes: float,
    iterations: int | None, preset: str, quality: str, duration_s: float, noise_m: float | None,
    draws: int, jobs: int,
) -> None:  # fmt: skip
    """Drive with the detectors of WEIGHTS and print tables; OUT/metrics.json has them, with noise a file of its own."""
    chosen = range(first_street, first_street + streets)
    kinds, name = kinds_of(noise_m, draws)
    for street in chosen:
        write_log(work, street)
        if noise_m is None:
            train_scene(work, street, preset, minutes, iterations)
    loops = Loops(work, weights, out, quality, duration_s)
    units = [replace(kind, street=street, seed=seed) for street in chosen for kind in kinds for seed in range(seeds)]
    results = {unit: found for unit in units if (found := loops.kept(unit)) is not None}
    missing = [unit for unit in units if unit not in results]
    bar = tqdm(total=len(units), initial=len(results), desc="loops", unit="loop")
    for unit, found in results_of(EXECUTORS["processes"].run(loops, missing, jobs)):
        results[unit] = found
        bar.update()
    bar.close()
    metrics: dict[str, Any] = {"weights": str(weights), "settings": loops.settings()}
    for street in chosen:
        pairs = [
            {kind.name: results[replace(kind, street=street, seed=seed)] for kind in kinds} for seed in range(seeds)
        ]
        metrics[f"street-{street}"] = metrics_of(pairs)
        click.echo("\n".join([f"\nstreet {street}: ", *lines(metrics[f"street-{street}"])]))
    write_file(out / name, json_bytes(metrics))


def kinds_of(noise_m: float | None, draws: int) -> tuple[tuple[Unit, Unit], str]:
    """Return the two loops that are compared, as units of any street and seed, and the name of the metrics' file."""
    exact = Unit(0, 0, EXACT)
    if noise_m is None:
        return (Unit(0, 0, RENDERED), exact), "metrics.json"
    drawn = [replace(exact, noise_m=noise_m, draw=draw) for draw in range(1, draws + 1)]
    return (drawn[0], drawn[-1] if draws > 1 else exact), f"metrics-noise-{noise_m:g}m-{draws}.json"


if __name__ == "__main__":
    try:
        main(prog_name="python -m benchmarks.rendered_beside_exact")
    except UnisimError as error:
        raise SystemExit(f"Error: {error}") from error
