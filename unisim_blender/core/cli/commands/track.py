"""`unisim track`: actors of a log without boxes, found in its sweeps."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import click

from ...data.moved import Choice
from ...errors import UnisimError
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
@click.option(
    "--boxes",
    type=PATH,
    help="Boxes from elsewhere, as of `unisim info`: tracks are written as they are, detections linked and fused with what is "
    "found.",
)
@click.option("--detector", metavar="NAME", help="An installed detector, whose tracks are fused with what is found.")
@click.option("--report", "page", type=PATH, help="A page of HTML to write: a picture from above, tracks over time.")
@click.option(
    "--film", type=PATH, help="A film to write, .mp4 or .html: recorded images with the boxes, sweeps from above."
)
@poses_option("auto")
@click.option("--quiet", is_flag=True, help="No progress bar.")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object a step in place of the bar.")
def command(
    log: Path, out: Path | None, certainty: float, boxes: Path | None, detector: str | None, page: Path | None, film: Path | None,
    poses: Choice, quiet: bool, as_json: bool,
) -> None:  # fmt: skip
    """Find what moves and what stands as vehicles do in the sweeps of LOG, and write its tracks as a file of boxes.

    Such a file is opened as the log with these boxes: by train, info, render, convert, and in Blender.
    """
    from ...export.film import write_log_film
    from ...files import write_file
    from ...formats.boxes import open_boxes, rows_of
    from ...formats.readers import drive_in, open_log
    from ...tracks.box_file import default_path, write_boxes
    from ...tracks.detections import detected_boxes, detector_named, fused, linked
    from ...tracks.find import find_tracks, in_own_world
    from ...tracks.report import report, summary
    from ...tracks.scans import scans_of

    recorded, out = open_log(log), out or default_path(log)
    if film is not None and film.suffix != ".html" and find_spec("imageio_ffmpeg") is None:
        raise UnisimError(
            f"--film {film}: needs imageio-ffmpeg: pip install imageio-ffmpeg, or give a path that ends with .html"
        )
    if boxes is not None and detector is not None:
        raise UnisimError(f"--boxes {boxes} and --detector {detector}: give one of the two")

    def show(stage: str, done: float) -> None:
        if as_json:
            click.echo(json.dumps({"share": done}))
        bar.set_description(stage, refresh=False)
        bar.update(round(100 * done) - bar.n)

    rows, given = rows_of(recorded, boxes) if boxes is not None else None, detector or (boxes.name if boxes else "")
    is_tracked = boxes is not None and (rows is None or bool((rows.uid != "").all()))
    has_sweeps = len(scans_of(recorded)) > 1
    used = posed(recorded, poses, quiet or as_json) if has_sweeps and not is_tracked else recorded
    with Bar(total=100, unit="%", delay=0.5, disable=quiet or as_json) as bar:
        if boxes is not None and is_tracked:
            content = open_boxes(drive_in(log), boxes)
            tracks, source = content.tracks, content.source
        else:
            if detector is not None:
                rows = detected_boxes(recorded, detector_named(detector), lambda done: show(detector, done))
            found = find_tracks(used, show) if has_sweeps or rows is None else ()
            tracks = in_own_world(found, used.drive, recorded.drive)
            if rows is not None:
                tracks = fused(tracks, linked(rows, given))
            tracks = tuple(track for track in tracks if track.certainty >= certainty)
            source = " and ".join(filter(None, ("unisim track", given)))
    write_boxes(out, recorded, tracks, source)
    if page is not None:
        write_file(page, report(recorded, tracks).encode())
    if film is not None:
        drive = replace(recorded.drive, actors={track.actor.uid: track.actor for track in tracks})
        with Bar(total=len(drive.frames), unit="frame", desc="film", delay=0.5, disable=quiet) as bar:
            write_log_film(recorded, drive, film, lambda done, total: bar.update())
    click.echo(f"{out}: {len(tracks)} tracks: {summary(tracks)}", err=as_json)
