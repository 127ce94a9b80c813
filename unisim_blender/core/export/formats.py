"""The formats of runs. Another is a module beside `mcap`, a line here, and its name among a scenario's formats."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ..errors import OutputError
from ..formats.coco import COCO
from ..formats.common.messages import RunFormat
from ..formats.mcap.write import MCAP
from ..formats.pandaset.write import PandasetWriter
from ..formats.rendered import camera_path, lidar_path, read_image, read_sweep
from ..formats.rosbag.write import ROSBAG
from ..prepare.scenario_plan import sequence_formats
from ..sequence.plan import RenderPlan, SequenceSettings
from ..world.captures import Moment
from ..world.drive import Camera, Drive, Lidar
from .finished_run import FinishedRun

if TYPE_CHECKING:  # a sequence's formats need no simulation
    from ..simulation.rollout.setup import OpenedScenario

LOG_FOLDER = "pandaset"


class SequenceFormat(NamedTuple):
    """``needs`` are the formats of frames that it is made of; ``write`` writes it into the sequence's folder; ``modules``
    are imported before anything is rendered, so that a missing package is told at once."""

    needs: tuple[str, ...]
    write: Callable[[RenderPlan, Path], object]
    modules: tuple[str, ...] = ()


def write_sequence(name: str, plan: RenderPlan, out: Path, images: Mapping[str, str] | None = None) -> None:
    """Write the finished sequence in folder ``out`` in a format, into that folder. ``images``: see `write_run`. Raises
    `UnisimError`."""
    if name in RUN_FORMATS:
        write_run(name, out, images)
    else:
        WRITERS[name].write(plan, out)


def write_rendered_log(plan: RenderPlan, out: Path) -> Path:
    """Write the log of what was rendered into ``out`` to ``out``/pandaset, whose path it gives. Raises `OutputError`.

    It is made of the captures' PNG and NPZ files, so both must have been written. Moments that are not all frames of
    the log are counted from 0.
    """
    check_formats(("pandaset",), plan.settings, out)
    drive = rendered_drive(plan)
    writer = PandasetWriter(out / LOG_FOLDER, drive)
    for frame, moment in zip(drive.frames, plan.moments, strict=True):
        for name in drive.cameras:
            path = camera_path(out, name, moment.name, ".png")
            if path.is_file():
                writer.write_image(name, frame, read_image(path))
        sweeps = {
            name: read_sweep(lidar_path(out, name, moment.name, ".npz"))
            for name in drive.lidars
            if frame in drive.lidars[name].time_s
        }
        if sweeps:
            writer.write_sweep(frame, sweeps)
        writer.write_cuboids(frame)
    writer.finish()
    return out / LOG_FOLDER


def rendered_drive(plan: RenderPlan) -> Drive:
    """The plan's drive with the moments as frames and the sensors that were rendered, at the size they
    were rendered at."""
    drive, settings = plan.drive, plan.settings
    cameras = {name: drive.cameras[name] for name in settings.cameras}
    if settings.width is not None:
        cameras = {
            name: replace(camera, model=camera.model.resized(settings.width)) for name, camera in cameras.items()
        }
    lidars = {name: drive.lidars[name] for name in settings.lidars}
    if len(plan.frames) == len(plan.moments):
        return replace(drive, frames=plan.frames, cameras=cameras, lidars=lidars)
    numbered = sorted(plan.moments, key=lambda moment: moment.time_us)
    if numbered != list(plan.moments):
        raise OutputError(
            f"{drive.name}: sensors with times of their own beside frames make no log in PandaSet's layout"
        )
    drive = replace(
        drive,
        frames=tuple(range(len(numbered))),
        cameras=cameras,
        lidars=lidars,
        time_s={i: moment.time_s(drive) for i, moment in enumerate(numbered)},
    )
    return drive.with_sensors(lambda sensor: replace(sensor, time_s=_times(sensor, numbered)))


def _times(sensor: Camera | Lidar, moments: Sequence[Moment]) -> dict[int, float]:
    """Return when a sensor was captured, by the numbers of the moments."""
    times = {}
    for i, moment in enumerate(moments):
        own = next((capture for capture in moment.captures.values() if capture.sensor_id == sensor.sensor_id), None)
        if own is not None:
            times[i] = own.time_s(sensor)
    return times


def _write_videos(plan: RenderPlan, out: Path) -> None:
    from ..output.video import playback, write_video

    for name in plan.settings.cameras:
        shown = [moment for moment in plan.moments if any(capture.sensor_id == name for capture in moment.cameras)]
        times = [moment.time_s(plan.drive) for moment in shown]
        rate, counts = playback(times)
        paths = [camera_path(out, name, moment.name, ".png") for moment in shown]
        images = [path for path, count in zip(paths, counts, strict=True) for _ in range(count) if path.is_file()]
        if images:
            write_video(images, out / "camera" / f"{name}.mp4", rate)


WRITERS = {
    "pandaset": SequenceFormat(("png", "npz"), write_rendered_log),
    "video": SequenceFormat(("png",), _write_videos, ("imageio_ffmpeg",)),
}
"""The formats beside those of runs."""


RUN_FORMATS: dict[str, RunFormat] = {form.name: form for form in (MCAP, ROSBAG, COCO)}

SENSORS = {"png": "cameras", "npz": "lidars"}
"""Formats of frames that runs without such sensors do without."""


def check_formats(names: Iterable[str], settings: SequenceSettings, place: Path | str) -> None:
    """Check that formats can be written of what is going to be rendered of the scenario at ``place``. Raises `OutputError` where
    files of frames would be missing, ModuleNotFoundError where a package is."""
    forms: dict[str, RunFormat | SequenceFormat] = {**RUN_FORMATS, **WRITERS}
    names = set(names)
    for name, form in forms.items():
        for module in form.modules if name in names else ():
            import_module(module)
        for need in form.needs if name in names else ():
            if need not in settings.formats and (need not in SENSORS or getattr(settings, SENSORS[need])):
                raise OutputError(
                    f"{place}: the format {name} is made of {need} files, and the scenario's formats lack them"
                )


def write_run(name: str, folder: Path, images: Mapping[str, str] | None = None) -> Path:
    """Write the run in a finished folder in a format of `RUN_FORMATS`, into that folder; the path. ``images``: see `FinishedRun`.
    Raises `UnisimError`."""
    form = RUN_FORMATS[name]
    form.write(FinishedRun(folder, images), folder / form.output)
    return folder / form.output


def write_runs(names: Iterable[str], folder: Path) -> None:
    """Write the run in a finished folder in several formats; names of other formats are passed over. Raises `UnisimError`."""
    for name in names:
        if name in RUN_FORMATS:
            write_run(name, folder)


@dataclass(frozen=True)
class RolloutFormats:
    """The formats that rollouts are written in: those ``asked`` for, and their scenario's; and whether a ``film`` is. It
    pickles."""

    asked: tuple[str, ...] = ()
    film: bool = False

    def __call__(self, opened: OpenedScenario) -> Callable[[Path], None]:
        """Return what writes a finished rollout of a scenario in them. Raises as `check_formats` does."""
        names = tuple(name for name in RUN_FORMATS if name in {*sequence_formats(opened.scenario), *self.asked})
        check_formats(names, opened.plan.settings, opened.scenario.path)

        def write(folder: Path) -> None:
            if self.film:
                from .film import write_film

                drive = opened.edited
                shown = [name for name in drive.cameras if name in opened.sensors][:1]
                shown += [name for name in drive.lidars if name in opened.sensors]
                write_film(folder, shown, recorded=drive.world_from_ego.positions)
            write_runs(names, folder)

        return write
