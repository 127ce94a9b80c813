"""`unisim track`: actors of a log without boxes, found in its sweeps."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import click

from ...data.moved import Choice
from ...errors import OutputError
from ...progress import Bar
from ..options import PATH, posed, poses_option


@click.command()
@click.argument("log", type=PATH)
@click.option("--out", type=PATH, help="File of boxes to write.  [default: LOG.boxes.json beside the log]")
@click.option(
    "--certainty",
    type=click.FloatRange(0, 1),
    default=0.3,
    show_default=True,
    help="Tracks that are less certain are left out.",
)
@click.option("--report", "page", type=PATH, help="A page of HTML to write: a picture from above, tracks over time.")
@poses_option("auto")
@click.option("--quiet", is_flag=True, help="No progress bar.")
def command(log: Path, out: Path | None, certainty: float, page: Path | None, poses: Choice, quiet: bool) -> None:
    """Find what moves and what stands as vehicles do in the sweeps of LOG, and write its tracks as a file of boxes.

    Such a file is opened as the log with these boxes: by train, info, render, convert, and in Blender.
    """
    from ...formats.readers import open_log
    from ...json_file import write_text
    from ...tracks.box_file import default_path, write_boxes
    from ...tracks.find import find_tracks, in_own_world
    from ...tracks.report import report
    from ...tracks.scans import scans_of

    recorded = open_log(log)
    used = posed(recorded, poses, quiet) if len(scans_of(recorded)) > 1 else recorded
    with Bar(total=100, unit="%", desc="ground", delay=0.5, disable=quiet) as bar:
        shown = ""

        def progress(stage: str, done: float) -> None:
            nonlocal shown
            if stage != shown:
                shown = stage
                bar.reset()
                bar.set_description(stage, refresh=False)
            bar.update(round(100 * done) - bar.n)

        tracks = [track for track in find_tracks(used, progress) if track.certainty >= certainty]
    out = out or default_path(log)
    write_boxes(out, recorded, in_own_world(tracks, used.drive, recorded.drive), "unisim track")
    if page is not None:
        write_text(page, report(used, tracks), OutputError)
    counts = Counter(f"{'moving' if track.actor.is_moving else 'standing'} {track.actor.label}" for track in tracks)
    click.echo(
        f"{out}: {len(tracks)} tracks: " + (", ".join(f"{n} {kind}" for kind, n in sorted(counts.items())) or "none")
    )
