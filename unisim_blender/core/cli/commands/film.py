"""`unisim film`: a finished sequence or rollout as one film."""

from __future__ import annotations

import json
from pathlib import Path

import click

from ...files import hold_folder
from ...prepare.selection import split_names
from ...progress import Bar
from ..options import PATH


@click.command()
@click.argument("folder", type=PATH)
@click.option("--sensors", metavar="A,B", help="Cameras and LiDARs by name, in this order. [default: all]")
@click.option(
    "--out",
    type=PATH,
    help="File to write, .mp4, or .html for a page that plays the film. [default: FOLDER/film.mp4, or FOLDER/film.html "
    "where imageio-ffmpeg is missing]",
)
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object a frame, and at last the file.")
def command(folder: Path, sensors: str | None, out: Path | None, as_json: bool) -> None:
    """Write what unisim render or unisim drive left in FOLDER as a film: cameras, and the LiDARs from above with boxes,
    side by side."""
    from ...export.film import write_film

    click.get_current_context().with_resource(hold_folder(folder))
    with Bar(unit="frame", dynamic_ncols=True, disable=as_json) as bar:

        def count(done: int, total: int) -> None:
            bar.total = total
            bar.update()
            if as_json:
                click.echo(json.dumps({"done": done, "total": total}))

        path = write_film(folder, split_names(sensors), out, count)
    click.echo(json.dumps({"file": str(path)}) if as_json else f"Film: {path}")
    if path.suffix == ".html" and out is None:
        click.echo("It is a page, for imageio-ffmpeg is missing: pip install imageio-ffmpeg for MP4", err=True)
