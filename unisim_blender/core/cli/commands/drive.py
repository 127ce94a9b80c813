"""`unisim drive`: a driver in the closed loop of a scenario."""

from __future__ import annotations

from pathlib import Path

import click

from ...export.formats import RUN_FORMATS, check_run_formats, write_run
from ...files import write_file
from ...json_file import json_bytes
from ...prepare.scenario_plan import RenderOptions, sequence_formats
from ...prepare.selection import split_names
from ...progress import Bar
from ...render.quality import QUALITY


def _drivers_help() -> str:
    from ...simulation.drivers import DRIVERS

    return "; ".join(f"{one.name}: {one.about}" for one in DRIVERS.values())


@click.command("drive")
@click.argument("scenario", type=click.Path(path_type=Path))
@click.option("--driver", required=True, metavar="NAME", help=f"{_drivers_help()}; or module:function.")
@click.option(
    "--out", required=True, type=click.Path(path_type=Path), help="Folder to write; it must be empty or not be there."
)
@click.option("--seed", type=click.IntRange(min=0), help="Of starts and of actors. [default: the scenario's, or 0]")
@click.option(
    "--start", "start_s", type=float, metavar="S", help="Seconds. [default: the scenario's, or the first frame's]"
)
@click.option(
    "--duration", "duration_s", type=float, metavar="S", help="Seconds. [default: the scenario's, or to the last frame]"
)
@click.option("--step", "step_s", type=float, metavar="S", help="Seconds of a step. [default: the scenario's, or 0.1]")
@click.option(
    "--delay",
    "delay_s",
    type=float,
    metavar="S",
    help="Seconds until an answer takes effect. [default: the scenario's, or 0]",
)
@click.option("--actors", metavar="MODEL", help="Model of all moving actors. [default: the scenario's, or replay]")
@click.option("--sensors", metavar="A,B", help="Cameras and LiDARs by name. [default: all of the scenario's]")
@click.option("--width", type=click.IntRange(min=8), help="Width of the images. [default: the cameras' own]")
@click.option("--quality", type=click.Choice(list(QUALITY)), help="[default: the scenario's, or balanced]")
@click.option("--renderer", metavar="NAME", help="As of `unisim render`.")
@click.option("--scene", type=click.Path(path_type=Path), help="A trained scene, in place of the scenario's.")
@click.option("--device", default="cpu", show_default=True, help="cpu, cuda, mps, or auto for the best there is.")
@click.option(
    "--format",
    "formats",
    type=click.Choice(list(RUN_FORMATS)),
    multiple=True,
    help="Write the whole rollout in this format, too: as of `unisim render`. Several, one option each.",
)
@click.option("--resume", is_flag=True, help="Continue a rollout that was interrupted.")
def command(
    scenario: Path,
    driver: str,
    out: Path,
    seed: int | None,
    start_s: float | None,
    duration_s: float | None,
    step_s: float | None,
    delay_s: float | None,
    actors: str | None,
    sensors: str | None,
    width: int | None,
    quality: str | None,
    renderer: str | None,
    scene: Path | None,
    device: str,
    formats: tuple[str, ...],
    resume: bool,
) -> None:
    """Let a driver drive through SCENARIO, or a log: what it did and saw, and the scenario that it made."""
    from ...prepare.devices import pick_device
    from ...scenario.simulation.document import OTHERS, SimulationSpec
    from ...simulation.drivers import driver_named
    from ...simulation.rollout.finish import finish
    from ...simulation.rollout.loop import roll_out
    from ...simulation.rollout.opening import note_simulation, open_scenario
    from ...simulation.rollout.score import SCORES_NAME, scores_of
    from ...simulation.scores.table import table as score_table

    options = RenderOptions(
        sensors=split_names(sensors),
        width=width,
        quality=quality,
        device=pick_device(device),
        renderer=renderer,
        scene=scene,
    )
    models = None if actors is None else {OTHERS: {"type": actors}}
    asked = SimulationSpec(start_s, duration_s, step_s, delay_s, seed, actors=models)
    kind = driver_named(driver)
    opened = open_scenario(scenario, options)
    wanted = {*sequence_formats(opened.scenario), *formats}
    check_run_formats(wanted, opened.plan.settings, scenario)
    simulation = opened.simulation(asked, kind, out)
    note_simulation(simulation, resume)
    for sentence in simulation.plan.about.get("warnings", ()):
        click.echo(f"Warning: {sentence}", err=True)
    stage = simulation.stage
    steps = -(-(stage.stop_us - stage.start_us) // stage.step_us)
    with Bar(total=steps, unit="step", dynamic_ncols=True, smoothing=0.1) as bar:
        rollout = roll_out(simulation, on_step=lambda world: bar.update())
    report = finish(simulation, rollout, options)
    scores = scores_of(simulation, rollout)
    write_file(out / SCORES_NAME, json_bytes(scores))
    for name in RUN_FORMATS:
        if name in wanted:
            write_run(name, out)
    click.echo(score_table(scores))
    if report.captures:
        click.echo(f"Warning: {report.captures} captures are not what the driver saw and were rendered anew", err=True)
    click.echo(f"{steps} steps, {report.captures_kept} captures: {out}")
