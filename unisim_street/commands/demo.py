"""`unisim demo`: the sample street, its scene and its edits, measured against the truth, in images."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import click

from unisim_blender.core.cli.commands.render import default_jobs
from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.progress import Bar

SAMPLE = Path("sample") / "scenario.json"


@click.command("demo")
@click.option(
    "--scenario", type=click.Path(path_type=Path), default=SAMPLE, show_default=True, help="A scenario on a street."
)
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out/demo"), show_default=True, help="Folder to write."
)
@click.option("--count", type=click.IntRange(min=1), default=3, show_default=True, help="Frames to render.")
def command(scenario: Path, out: Path, count: int) -> None:
    """Make the sample street's log, render its edits, compare them with the truth, and make a contact sheet."""
    from ..demo import run_demo

    if not scenario.is_file():
        raise ScenarioError(f"{scenario}: is not there; run the demo in the repository's folder, or name a --scenario")
    result = run_demo(scenario, out, count, default_jobs("cpu"), _make_log, click.echo, _progress)
    camera, lidar = result.metrics["camera"], result.metrics["lidar"]
    click.echo(f"\nAgainst the truth, frames {', '.join(map(str, result.frames))}:")
    click.echo(f"{'':28}{'replay':>10}{'edited':>10}")
    for label, name, unit in (("camera PSNR", "psnr_db", "dB"), ("camera SSIM", "ssim", "")):
        _row(label, camera["replay"][name], camera["edit"][name], unit)
    _row("PSNR in the edited region", camera["replay"]["edited"]["psnr_db"], camera["edit"]["edited"]["psnr_db"], "dB")
    _row(
        "PSNR of pixels seen before",
        camera["replay"]["frame_seen"]["psnr_db"],
        camera["edit"]["frame_seen"]["psnr_db"],
        "dB",
    )
    for label, name, scale, unit in (
        ("LiDAR median error", "depth_median_m", 100, "cm"),
        ("LiDAR p90 error", "depth_p90_m", 100, "cm"),
        ("LiDAR hit rate", "hit_rate", 100, "%"),
    ):
        replay, edited = (lidar[part].get(name) for part in ("replay", "edit"))
        _row(label, None if replay is None else replay * scale, None if edited is None else edited * scale, unit)
    click.echo(
        f"\nContact sheet:   {result.contact_sheet}\nPage:            {result.page}\nRendered frames: {result.rendered}"
    )


def _row(label: str, replay: float | None, edited: float | None, unit: str) -> None:
    cells = "".join(f"{'-' if value is None else format(value, '.2f'):>10}" for value in (replay, edited))
    click.echo(f"{label:28}{cells} {unit}")


def _make_log(path: Path, options: dict[str, float | str]) -> None:
    from .synth import command as synth

    arguments = [str(path), *(part for name, value in options.items() for part in (f"--{name}", str(value)))]
    synth.main(arguments, standalone_mode=False)


def _progress(frames: Iterable[int], what: str) -> Iterable[int]:
    return Bar(frames, desc=what, unit="frame", dynamic_ncols=True)
