"""`unisim convert`: a recorded or rendered drive as a log in another layout."""

from __future__ import annotations

from pathlib import Path

import click

from ...progress import Bar


def _writers_help() -> str:
    from ...convert.writers import all_writers

    return "; ".join(f"{writer.name}: {writer.about}" for writer in all_writers().values())


@click.command("convert")
@click.argument("log", metavar="LOG_OR_RENDERED", type=click.Path(path_type=Path))
@click.option("--to", "layout", required=True, metavar="LAYOUT", help=f"{_writers_help()}.")
@click.option(
    "--out", required=True, type=click.Path(path_type=Path), help="Folder to write; it must be empty or not be there."
)
@click.option("--quiet", is_flag=True, help="No progress bar.")
def command(log: Path, layout: str, out: Path, quiet: bool) -> None:
    """Write a log, or a folder that `unisim render` wrote, as a log in another layout, labels included.

    An interrupted conversion goes on where it was when the same command is given again.
    """
    from ...convert.run import convert
    from ...convert.source import open_source
    from ...convert.writers import writer_named

    writer = writer_named(layout)
    source = open_source(log)
    with Bar(unit="capture", dynamic_ncols=True, smoothing=0.1, delay=0.5, disable=quiet) as bar:

        def start(captures: int, losses: tuple[str, ...]) -> None:
            for sentence in losses:
                click.echo(f"Warning: {sentence}", err=True)
            bar.total = captures
            bar.refresh()

        done = convert(source, writer, out, start, bar.update, bar.update)
    if done.was_there:
        click.echo(f"Nothing to do: {done.opens} holds this conversion, of {done.kept} images and sweeps")
        return
    kept = f", {done.kept} were there already" if done.kept else ""
    click.echo(f"{done.written} images and sweeps written{kept}: {done.opens}")
