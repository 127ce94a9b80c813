"""`unisim track`: actors of a log without boxes, found in its sweeps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
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
def command(
    log: Path, out: Path | None, certainty: float, boxes: Path | None, detector: str | None, page: Path | None, film: Path | None,
    poses: Choice, quiet: bool,
) -> None:  # fmt: skip
    """Find what moves and what stands as vehicles do in the sweeps of LOG, and write its tracks as a file of boxes.

    Such a file is opened as the log with these boxes: by train, info, render, convert, and in Blender.
    """
    from ...export.film import write_log_film
    from ...files import write_file
    from ...formats.boxes import open_boxes, rows_of
    from ...formats.readers import drive_in, open_log
    from ...tracks.box_file import Track, default_path, write_boxes
    from ...tracks.detections import detected_boxes, detector_named, fused, linked
    from ...tracks.find import find_tracks, in_own_world
    from ...tracks.report import report
    from ...tracks.scans import scans_of

    recorded = open_log(log)
    rows, source = None, ""
    if film is not None and film.suffix != ".html" and find_spec("imageio_ffmpeg") is None:
        raise UnisimError(
            f"--film {film}: needs imageio-ffmpeg: pip install imageio-ffmpeg, or give a path that ends with .html"
        )

    def shown_as(tracks: Sequence[Track]) -> None:
        if page is not None:
            write_file(page, report(recorded, tracks).encode())
        if film is not None:
            drive = replace(recorded.drive, actors={track.actor.uid: track.actor for track in tracks})
            with Bar(total=len(drive.frames), unit="frame", desc="film", delay=0.5, disable=quiet) as bar:
                write_log_film(recorded, drive, film, lambda done, total: bar.update())

    if boxes is not None and detector is not None:
        raise UnisimError(f"--boxes {boxes} and --detector {detector}: give one of the two")
    if boxes is not None:
        rows, source = rows_of(recorded, boxes), boxes.name
        if rows is None or (rows.uid != "").all():
            content = open_boxes(drive_in(log), boxes)
            write_boxes(out or default_path(log), recorded, content.tracks, content.source)
            click.echo(f"{out or default_path(log)}: {len(content.tracks)} tracks of {boxes}")
            shown_as(content.tracks)
            return
    if detector is not None:
        chosen = detector_named(detector)
        with Bar(total=100, unit="%", desc=detector, delay=0.5, disable=quiet) as bar:
            rows = detected_boxes(recorded, chosen, lambda done: bar.update(round(100 * done) - bar.n))
        source = detector
    enough = len(scans_of(recorded)) > 1
    used = posed(recorded, poses, quiet) if enough else recorded
    with Bar(total=100, unit="%", desc="ground", delay=0.5, disable=quiet) as bar:
        shown = ""

        def progress(stage: str, done: float) -> None:
            nonlocal shown
            if stage != shown:
                shown = stage
                bar.reset()
                bar.set_description(stage, refresh=False)
            bar.update(round(100 * done) - bar.n)

        found = find_tracks(used, progress) if enough or rows is None else ()
    tracks = in_own_world(found, used.drive, recorded.drive)
    if rows is not None:
        tracks = fused(tracks, linked(rows, source))
    tracks = tuple(track for track in tracks if track.certainty >= certainty)
    out = out or default_path(log)
    write_boxes(out, recorded, tracks, " and ".join(filter(None, ("unisim track", source))))
    shown_as(tracks)
    counts = Counter(f"{'moving' if track.actor.is_moving else 'standing'} {track.actor.label}" for track in tracks)
    click.echo(
        f"{out}: {len(tracks)} tracks: " + (", ".join(f"{n} {kind}" for kind, n in sorted(counts.items())) or "none")
    )
