"""Drivers in the closed loop of one scenario: a table of their scores.

    python -m benchmarks.drivers SCENARIO --out FOLDER --weights FOLDER [--check-bytes]

One rollout each, without random starts. FOLDER gets a rollout's folder for each driver, and the table. `--check-bytes` also
compares bytes, of short rollouts with random starts: of a seed twice, of one process and three, of the rollout's scenario
rendered, of `log` and the replay. It exits with status 1 where they differ.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import click

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.export.formats import RolloutFormats
from unisim_blender.core.files import write_file
from unisim_blender.core.prepare.scenario_plan import RenderOptions
from unisim_blender.core.prepare.selection import split_names
from unisim_blender.core.render.quality import QUALITIES
from unisim_blender.core.scenario.simulation import SimulationSpec
from unisim_blender.core.simulation.rollout.run import complete
from unisim_blender.core.simulation.rollout.setup import note_scenario, open_scenario

from .asked import JITTER, seconds_for, write_asked
from .drivers import DRIVERS, entries
from .same_bytes import checks, replay_check
from .table import markdown


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120})
@click.argument("source", metavar="SCENARIO", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder to write.")
@click.option("--driver", "names", type=click.Choice(DRIVERS), multiple=True, help="Several, one each.  [default: all]")
@click.option("--weights", type=click.Path(path_type=Path), help="Folder of the detectors of perception.")
@click.option("--seconds", default=10.0, show_default=True, help="So long; log at most to the recording's end.")
@click.option("--actors", default="auto", show_default=True, help="Model of moving actors that name none.")
@click.option("--period", "period_s", type=float, metavar="S", help="Between captures.  [default: as recorded]")
@click.option("--sensors", metavar="A,B", help="Cameras and LiDARs by name.  [default: all]")
@click.option("--width", type=click.IntRange(min=8))
@click.option("--quality", type=click.Choice(list(QUALITIES)), default="fast", show_default=True)
@click.option("--renderer", metavar="NAME", help="As of `unisim render`.")
@click.option("--scene", type=click.Path(path_type=Path), help="A trained scene, in place of the scenario's.")
@click.option("--film", is_flag=True, help="Write films, too.")
@click.option("--check-bytes", is_flag=True, help="Compare bytes, too.")
@click.option("--check-seconds", default=1.0, show_default=True, help="Length of the rollouts that are compared.")
def main(
    source: Path, out: Path, names: tuple[str, ...], weights: Path | None, seconds: float, actors: str,
    period_s: float | None, sensors: str | None, width: int | None, quality: str, renderer: str | None,
    scene: Path | None, film: bool, check_bytes: bool, check_seconds: float,
) -> None:  # fmt: skip
    """Let drivers drive through SCENARIO, or a log, and print a table of their scores."""
    options = RenderOptions(sensors=split_names(sensors), width=width, quality=quality, renderer=renderer, scene=scene)
    asked = write_asked(source, options, actors, period_s, out / "asked.json")
    opened = open_scenario(asked, options)
    found: dict[str, dict[str, Any]] = {}
    same: list[str] = []
    with entries(names or DRIVERS, weights) as chosen:
        for entry in chosen:
            kind = entry.kind()
            begun, lasts = time.monotonic(), seconds_for(asked, options, kind.drives, seconds)
            simulation = opened.simulation(SimulationSpec(duration_s=lasts, seed=0), kind, out / entry.name)
            note_scenario(simulation.scenario, simulation.out, True)
            done = complete(simulation, options, write=RolloutFormats(film=film)(opened))
            found[entry.name] = done.scores
            click.echo(f"{entry.name}: {time.monotonic() - begun:.0f} s, {done.anew} captures rendered anew", err=True)
        if check_bytes:
            drawn = write_asked(source, options, actors, period_s, out / "drawn.json", JITTER)
            with_starts = open_scenario(drawn, options)
            short = SimulationSpec(duration_s=check_seconds)
            for entry in chosen:
                for check in checks(entry, drawn, with_starts, options, short, out / "bytes" / entry.name):
                    same.append(_line(entry.name, check.what, check.files, check.different))
                if entry.name == "log":
                    lasts = seconds_for(asked, options, False, seconds)
                    one = replay_check(entry, asked, opened, lasts, out / "log", out / "bytes" / "replay", options)
                    same.append(_line(entry.name, one.what, one.files, one.different))
    text = markdown(found)
    if same:
        text += "\n\n| driver | compared | files | different |\n|---|---|---|---|\n" + "\n".join(same)
    click.echo(text)
    write_file(out / "table.md", f"{text}\n".encode())
    sys.exit(any(not line.endswith("| 0 |") for line in same))


def _line(driver: str, what: str, files: int, different: tuple[str, ...]) -> str:
    shown = f"{len(different)}: {', '.join(different[:3])}" if different or not files else "0"
    return f"| `{driver}` | {what} | {files} | {shown} |"


if __name__ == "__main__":
    try:
        main(prog_name="python -m benchmarks.drivers")
    except UnisimError as error:
        raise SystemExit(f"Error: {error}") from error
