"""Formats that are made of a whole rendered sequence, after its frames: logs, films, and the formats of runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from ..errors import OutputError
from ..output.frame_files import camera_path
from ..sequence.plan import RenderPlan, SequenceSettings
from .formats import RUN_FORMATS, SENSORS, check_run_formats, write_run


class SequenceFormat(NamedTuple):
    """``needs`` are the formats of frames that it is made of; ``write`` writes it into the sequence's folder."""

    needs: tuple[str, ...]
    write: Callable[[RenderPlan, Path], object]


def check_sequence_formats(names: Iterable[str], settings: SequenceSettings, place: Path | str) -> None:
    """Check that formats can be written of what is going to be rendered of the scenario at ``place``. Raises `OutputError` where
    files of frames would be missing, ModuleNotFoundError where a package is."""
    names = tuple(names)
    check_run_formats(names, settings, place)
    for name in names:
        for need in WRITERS[name].needs if name in WRITERS else ():
            if need not in settings.formats and getattr(settings, SENSORS[need]):
                raise OutputError(
                    f"{place}: the format {name} is made of {need} files, and the scenario's formats lack them"
                )


def write_sequence(name: str, plan: RenderPlan, out: Path, images: Mapping[str, str] | None = None) -> None:
    """Write the finished sequence in folder ``out`` in a format, into that folder. ``images``: see `write_run`. Raises
    `UnisimError`."""
    if name in RUN_FORMATS:
        write_run(name, out, images)
    else:
        WRITERS[name].write(plan, out)


def _write_pandaset(plan: RenderPlan, out: Path) -> None:
    from ..sequence.rendered_log import write_rendered_log

    write_rendered_log(plan, out)


def _write_videos(plan: RenderPlan, out: Path) -> None:
    from ..output.playback import playback
    from ..output.video import write_video

    for name in plan.settings.cameras:
        shown = [one for one in plan.moments if any(capture.sensor_id == name for capture in one.cameras)]
        times = [moment.time_s(plan.drive) for moment in shown]
        rate, counts = playback(times)
        paths = [camera_path(out, name, moment.name, ".png") for moment in shown]
        images = [path for path, count in zip(paths, counts, strict=True) for _ in range(count) if path.is_file()]
        if images:
            write_video(images, out / "camera" / f"{name}.mp4", rate)


WRITERS = {
    "pandaset": SequenceFormat(("png", "npz"), _write_pandaset),
    "video": SequenceFormat(("png",), _write_videos),
}
"""The formats beside those of runs."""
