"""Numerical stability at full size: the cases of tests/core/stress, their errors and bounds, as a table and as JSON.

python benchmarks/stability.py [--full N] [--json FILE] [CASE...]
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import click

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "core"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from stress.cases import CASES
from stress.measures import Bench, Measure
from stress.variants import compared_variants

from unisim_blender.core import native


def worst(measures: list[Measure]) -> Measure:
    """The one nearest to its bound, or farthest beyond it."""
    return max(measures, key=lambda m: (not m.kept, m.error / m.bound if m.bound else 0.0))


@click.command()
@click.option("--full", default=8, show_default=True, help="Pictures are so many times as large as in the tests.")
@click.option(
    "--json", "file", type=click.Path(dir_okay=False, path_type=Path), help="Every measure, for other programs."
)
@click.argument("names", nargs=-1)
def main(full: int, file: Path | None, names: tuple[str, ...]) -> None:
    """Run every case, or those named, and print what came nearest to its bound in each."""
    cases = {**CASES, "instruction sets": compared_variants}
    click.echo(f"variant {native.variant()}, images of {48 * full} x {32 * full}\n")
    click.echo("| case | nearest to its bound | error | bound | kept |\n|---|---|---|---|---|")
    rows: dict[str, list[Measure]] = defaultdict(list)
    for name in names or cases:
        with tempfile.TemporaryDirectory() as folder:
            rows[name] += cases[name](Bench(Path(folder), full))
        last, kept = worst(rows[name]), sum(m.kept for m in rows[name])
        click.echo(f"| {name} | {last.what} | {last.error:.2g} | {last.bound:.2g} | {kept} of {len(rows[name])} |")
    if file is not None:
        written = [
            {"case": name, "what": m.what, "error": m.error, "bound": m.bound, "kept": m.kept}
            for name in rows
            for m in rows[name]
        ]
        file.write_text(json.dumps({"variant": native.variant(), "full": full, "measures": written}, indent=1))
    sys.exit(not all(m.kept for measures in rows.values() for m in measures))


if __name__ == "__main__":
    main()
