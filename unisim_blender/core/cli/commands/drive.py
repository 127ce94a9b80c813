"""`unisim drive`: a driver in the closed loop of a scenario."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ...errors import UnisimError
from ...export.formats import RUN_FORMATS, RolloutFormats
from ...files import hold_folder
from ...prepare.scenario_plan import RenderOptions
from ...progress import Bar
from ..options import PATH, SourceParam, out_option, render_options


def _drivers_help() -> str:
    from ...simulation.drivers import DRIVERS

    return "; ".join(f"{driver.name}: {driver.about}" for driver in DRIVERS.values())


@click.command("drive")
@click.argument("scenario", type=SourceParam())
@click.option("--driver", required=True, metavar="NAME", help=f"{_drivers_help()}; or module:function.")
@click.option("--driver-address", metavar="HOST:PORT", help="Where a driver listens that is a process of its own.")
@click.option(
    "--driver-ca",
    type=PATH,
    help="Certificates (PEM) by which a driver on another machine is known: it is asked through TLS.",
)
@out_option()
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
@render_options("the scenario's")
@click.option(
    "--format",
    "formats",
    type=click.Choice(list(RUN_FORMATS)),
    multiple=True,
    help="Write a whole rollout in this format, too: as of `unisim render`. Several, one option each.",
)
@click.option("--film", is_flag=True, help="Write a film, too: the first camera, and the LiDARs from above.")
@click.option(
    "--rollouts",
    type=click.IntRange(1, 100_000),
    metavar="N",
    help="So many, with the seeds from --seed on, each in OUT/seed-SEED.",
)
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Processes that run rollouts.")
@click.option("--resume", is_flag=True, help="Continue rollouts that were interrupted.")
def command(
    scenario: Path | str,
    driver: str,
    driver_address: str | None,
    driver_ca: Path | None,
    out: Path,
    seed: int | None,
    actors: str | None,
    options: RenderOptions,
    formats: tuple[str, ...],
    film: bool,
    rollouts: int | None,
    jobs: int,
    resume: bool,
    **times_s: Any,
) -> None:
    """Let a driver drive through SCENARIO, or a log: what it did and saw, and the scenario that it made."""
    from ...scenario.simulation import OTHER_ACTORS, SimulationSpec
    from ...simulation.drivers import Endpoint, driver_named
    from ...simulation.rollout.run import Seeds, complete, run_seeds
    from ...simulation.rollout.setup import note_scenario, open_scenario
    from ...simulation.scores.summary import score_table

    models = None if actors is None else {OTHER_ACTORS: {"type": actors}}
    asked = SimulationSpec(**times_s, seed=seed, actors=models)
    if driver_ca is not None and driver_address is None:
        raise UnisimError(f"--driver-ca {driver_ca}: needs --driver-address")
    endpoint = None if driver_address is None else Endpoint(driver_address, driver_ca)
    kind = driver_named(driver, endpoint)
    if rollouts is not None:
        seeds = Seeds(scenario, options, asked, driver, out, resume, endpoint, RolloutFormats(formats, film))
        with Bar(total=rollouts, unit="rollout", dynamic_ncols=True) as bar:
            for done in run_seeds(seeds, seed or 0, rollouts, jobs):
                bar.update()
                click.echo(f"{done.captures} captures: {out / f'seed-{done.seed}'}")
        return
    if jobs > 1:
        raise UnisimError("--jobs: one rollout runs in one process; give --rollouts, too")
    click.get_current_context().with_resource(hold_folder(out))
    opened = open_scenario(scenario, options)
    write = RolloutFormats(formats, film)(opened)
    simulation = opened.simulation(asked, kind, out)
    note_scenario(simulation.scenario, out, resume)
    for sentence in simulation.plan.about.get("warnings", ()):
        click.echo(f"Warning: {sentence}", err=True)
    context = simulation.context
    steps = -(-(context.stop_us - context.start_us) // context.step_us)
    with Bar(total=steps, unit="step", dynamic_ncols=True, smoothing=0.1) as bar:
        done = complete(simulation, options, on_step=lambda world: bar.update(), write=write)
    click.echo(score_table(done.scores))
    if done.anew:
        click.echo(f"Warning: {done.anew} captures are not what the driver saw and were rendered anew", err=True)
    click.echo(f"{steps} steps, {done.captures - done.anew} captures: {out}")
