"""`unisim convert`: a recorded or rendered drive as a log in another layout, a scenario in another program's format, and back."""

from __future__ import annotations

from pathlib import Path

import click

from ...data.moved import Choice
from ...errors import UnisimError
from ...progress import Bar
from ..options import PATH, boxes_option, out_option, posed, poses_option


def _writers_help() -> str:
    from ...convert import WRITERS
    from ...formats.writers import WRITERS as LOG_WRITERS

    kinds = [(writer.name, writer.about) for writer in LOG_WRITERS.with_plugins().values()]
    return "; ".join(
        f"{name}: {about}" for name, about in (*kinds, *((writer.name, writer.about) for writer in WRITERS.values()))
    )


@click.command("convert")
@click.argument("source", metavar="SOURCE", type=PATH)
@boxes_option("source")
@click.option("--to", "layout", metavar="LAYOUT", help=f"{_writers_help()}.")
@click.option(
    "--from",
    "from_format",
    type=click.Choice(["openscenario"]),
    help="SOURCE is a file of this format; a scenario is made of it.",
)
@click.option(
    "--log", type=PATH, help="With --from: the log, scenario or trained scene that the file's entities are actors of."
)
@click.option(
    "--map",
    "mapped",
    multiple=True,
    metavar="ENTITY=ACTOR",
    help="With --from: the log's actor that an entity of the file is, or ego; may be given more than once.",
)
@poses_option("log")
@out_option()
@click.option("--quiet", is_flag=True, help="No progress bar.")
def command(
    source: Path,
    layout: str | None,
    from_format: str | None,
    log: Path | None,
    mapped: tuple[str, ...],
    poses: Choice,
    out: Path,
    quiet: bool,
) -> None:
    """Write a log, or a folder that `unisim render` wrote, as a log in another layout, labels included; a scenario in
    another program's format; or, with --from, a file of such a format as a scenario.

    An interrupted conversion of a log goes on where it was when the same command is given again.
    """
    from ...convert import WRITERS, read_scenario, write_scenario

    if (layout is None) == (from_format is None):
        raise UnisimError("convert: give --to or --from, one of the two")
    if (log is None) != (from_format is None):
        raise UnisimError("convert: --from and --log go together")
    if mapped and from_format is None:
        raise UnisimError("convert: --map needs --from")
    actors = _actors_of(mapped)
    if layout is not None and layout not in WRITERS:
        _convert_log(source, layout, poses, out, quiet)
        return
    if layout is not None:
        done = write_scenario(source, layout, out)
    else:
        assert log is not None
        done = read_scenario(source, log, out, actors)
    for sentence in done.losses:
        click.echo(f"Warning: {sentence}", err=True)
    click.echo(f"Written: {done.file}")


def _actors_of(mapped: tuple[str, ...]) -> dict[str, str]:
    actors: dict[str, str] = {}
    for pair in mapped:
        entity, _, actor = pair.rpartition("=")
        if not entity or not actor:
            raise UnisimError(f"--map {pair}: must be ENTITY=ACTOR")
        if entity in actors:
            raise UnisimError(f"--map {pair}: {entity} is mapped twice")
        actors[entity] = actor
    return actors


def _convert_log(log: Path, layout: str, poses: Choice, out: Path, quiet: bool) -> None:
    from ...convert import WRITERS, convert, open_source
    from ...data.values import doubts
    from ...formats.writers import WRITERS as LOG_WRITERS
    from ...formats.writers import writer_named

    if layout not in LOG_WRITERS.with_plugins():
        raise UnisimError(f"--to {layout}: must be one of {', '.join((*LOG_WRITERS.with_plugins(), *WRITERS))}")
    writer = writer_named(layout)
    source = open_source(log, (lambda recorded: posed(recorded, poses, quiet)) if poses != "log" else None)
    for sentence in doubts(source.log):
        click.echo(f"Warning: {sentence}", err=True)
    with Bar(unit="capture", dynamic_ncols=True, smoothing=0.1, delay=0.5, disable=quiet) as bar:

        def start(captures: int, losses: tuple[str, ...]) -> None:
            for sentence in losses:
                click.echo(f"Warning: {sentence}", err=True)
            bar.total = captures
            bar.refresh()

        done = convert(source, writer, out, start, bar.update, bar.update)
    if done.was_there:
        click.echo(f"Nothing to do: {done.opens} holds this conversion, of {done.reused} images and sweeps")
        return
    earlier = f", {done.reused} were there already" if done.reused else ""
    click.echo(f"{done.written} images and sweeps written{earlier}: {done.opens}")
