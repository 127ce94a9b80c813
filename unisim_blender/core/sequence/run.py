"""Frames of one drive rendered into a folder, by one or several processes, and taken up again where a run was cut off.

Every finished capture leaves a record of its identity and of its files' digests, written after the files. A capture whose record
and files agree with what is asked for is not rendered again. The manifest is made of the records, so but for what it says of the
last run it does not depend on how often or where a run was interrupted. Every process renders with one thread of torch: where
torch cuts an array among threads it changes the last bit of what lies at the cuts, and the bytes must not depend on threads.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import OutputError
from ..files import remove_partial_files, sha256_of_file, write_file
from ..json_file import json_bytes
from ..output.frame_files import labels_bytes, labels_path, write_camera, write_labels, write_lidar
from ..processes import single_threaded
from ..sensors.frames import CameraFrame, LidarFrame, RenderStats
from .executors import usual_executor
from .executors.executor import Executor, ProcessLost
from .identity import CaptureIdentities, Identity
from .manifest import COUNTS, LABELS, make_manifest
from .plan import FrameRenderer, RenderPlan
from .records import CaptureRecord, Captures, read_records, remove_files, write_record

MANIFEST_NAME = "manifest.json"
TIMINGS_NAME = "timings.json"


@dataclass(frozen=True)
class RenderReport:
    """What a run did: frames of which something was rendered now, frames found finished, wall-clock seconds, and which sensors
    of which frames do not keep the error that was asked for. ``captures`` are rendered now, ``captures_kept`` were there."""

    rendered: tuple[int, ...]
    kept: tuple[int, ...]
    seconds: float
    broken: tuple[str, ...] = ()
    captures: int = 0
    captures_kept: int = 0


def render_sequence(
    plan: RenderPlan,
    out: Path,
    jobs: int = 1,
    resume: bool = False,
    on_frame: Callable[[int], object] = lambda frame: None,
    on_kept: Callable[[int], object] = lambda count: None,
    executor: Executor | None = None,
) -> RenderReport:
    """Render the plan's frames into folder ``out`` and write its manifest.

    What is there already and has the identity that is asked for stays (`identity.py`): after an edit, the captures alone that can
    see it are rendered again. ``on_kept`` is called once with the number of frames that were finished before, ``on_frame`` after
    each frame. ``executor`` renders them, ``jobs`` at a time; None is this process, or several ones where ``jobs`` says so.

    Raises `OutputError` where ``out`` holds something already and ``resume`` is not set, or where it cannot be written; finished
    captures stay in every case.
    """
    started = time.monotonic()
    if not resume and out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(f"{out}: is not empty; name another folder, or continue the render it holds with --resume")
    remove_partial_files(out)
    identities = CaptureIdentities(plan)
    kept = keep_what_holds(plan, out, identities)
    work = [Work(frame, identities.of_frame(frame), kept.get(frame, {})) for frame in plan.frames]
    work = [one for one in work if one.to_render or not one.kept]
    to_do = [one.frame for one in work]
    if to_do:
        (out / MANIFEST_NAME).unlink(missing_ok=True)
    relabelled = _write_labels(plan, out, identities, kept)
    timings = _read_timings(out)
    on_kept(len(plan.frames) - len(to_do))
    try:
        executor = executor or usual_executor(jobs, len(work))
        for frame, seconds in executor.run(FrameRendering(plan, out), work, jobs):
            timings[str(frame)] = {**timings.get(str(frame), {}), **seconds}
            on_frame(frame)
    except ProcessLost as error:
        raise OutputError(f"{out}: {error}; finished frames are kept, continue with --resume and fewer --jobs") from error
    finally:
        remove_partial_files(out)
        if out.is_dir():
            write_file(out / TIMINGS_NAME, json_bytes({name: timings[name] for name in sorted(timings, key=int)}))
    manifest = make_manifest(plan, out, _last_run(work, kept, relabelled))
    write_file(out / MANIFEST_NAME, json_bytes(manifest))
    done = tuple(frame for frame in plan.frames if frame not in to_do)
    broken = tuple(manifest.get("max_error", {}).get("not_kept", ()))
    captures = sum(len(one.to_render) for one in work)
    there = sum(len(kept.get(frame, {}).keys() - {LABELS}) for frame in plan.frames)
    return RenderReport(tuple(to_do), done, time.monotonic() - started, broken, captures, there)


@dataclass(frozen=True)
class Work:
    """A frame of which captures are to be rendered: ``wanted`` identities and what each capture sees, by its name, and the
    records of those that are ``kept``."""

    frame: int
    wanted: Mapping[str, Identity]
    kept: Captures

    @property
    def to_render(self) -> list[str]:
        """The captures that are not there, cameras first."""
        return [name for name in self.wanted if name not in self.kept]


def keep_what_holds(plan: RenderPlan, out: Path, identities: CaptureIdentities) -> dict[int, Captures]:
    """Remove captures in a folder whose identity is another one than is asked for, or whose files are damaged; return the
    records of those that stay, by frame."""
    kept: dict[int, Captures] = {}
    for frame, captures in read_records(out).items():
        wanted = {name: identity for name, (identity, _) in identities.of_frame(frame).items()}
        if "labels" in plan.settings.formats and frame in plan.drive.time_s:
            wanted[LABELS] = labels_record(plan, frame).identity
        holds = {
            name: record for name, record in captures.items() if wanted.get(name) == record.identity and record.is_whole(out)
        }
        if frame not in plan.frames and wanted.keys() - holds.keys():
            holds = {}  # nobody would finish it
        for name in captures.keys() - holds.keys():
            remove_files(out, captures[name])
        kept[frame] = holds
        if len(holds) < len(captures):
            write_record(out, frame, holds, finished=not wanted.keys() - holds.keys())
    return kept


def _write_labels(plan: RenderPlan, out: Path, identities: CaptureIdentities, kept: Mapping[int, Captures]) -> list[int]:
    """Write labels of frames of which nothing else is to be written; return these frames."""
    changed = []
    for frame in plan.frames if "labels" in plan.settings.formats else ():
        captures = kept.get(frame, {})
        if captures and LABELS not in captures and not identities.of_frame(frame).keys() - captures.keys():
            write_labels(out, plan.drive, frame)
            write_record(out, frame, {**captures, LABELS: labels_record(plan, frame)}, finished=True)
            changed.append(frame)
    return changed


def labels_record(plan: RenderPlan, frame: int) -> CaptureRecord:
    """Return the record of a frame's labels, whose identity is what they say."""
    digest = hashlib.sha256(labels_bytes(plan.drive, frame)).hexdigest()
    return CaptureRecord(digest, {labels_path(Path(), frame).as_posix(): digest})


def render_frame(plan: RenderPlan, renderer: FrameRenderer, out: Path, work: Work) -> dict[str, float]:
    """Render the captures of a frame that are not there, write their files and then the frame's record; seconds by capture."""
    settings, frame, seconds = plan.settings, work.frame, {}
    captures = {name: record for name, record in work.kept.items() if name in work.wanted}
    for name in work.to_render:
        started = time.monotonic()
        kind, sensor = name.split("/", 1)
        shot: CameraFrame | LidarFrame
        if kind == "camera":
            shot = image = renderer.camera(sensor, frame, settings.passes, settings.width)
            files = write_camera(out, sensor, frame, plan.drive.cameras[sensor].time_s[frame], image, settings.formats)
        else:
            shot = sweep = renderer.lidar(sensor, frame)
            files = write_lidar(out, sensor, frame, plan.drive.lidars[sensor].time_s[frame], sweep, settings.formats)
        identity, sees = work.wanted[name]
        digests = {path.relative_to(out).as_posix(): sha256_of_file(path) for path in files}
        error = None if shot.error_bound is None else shot.error_bound.to_json()
        captures[name] = CaptureRecord(identity, digests, sees, _counts(shot.stats), error)
        write_record(out, frame, captures, finished=False)
        seconds[name] = time.monotonic() - started
    if "labels" in settings.formats:
        write_labels(out, plan.drive, frame)
        captures[LABELS] = labels_record(plan, frame)
    write_record(out, frame, captures, finished=True)
    return seconds


def _counts(stats: RenderStats) -> dict[str, int]:
    return {name: getattr(stats, name) for name in COUNTS}


def _last_run(work: Sequence[Work], kept: Mapping[int, Captures], relabelled: Sequence[int]) -> dict[str, Any]:
    """Return what the manifest says of the run that wrote it: what was rendered, what was kept, and why."""
    return {
        "rendered": {f"{one.frame:06d}": one.to_render for one in work},
        "labels_alone": [f"{frame:06d}" for frame in relabelled],
        "kept": {f"{frame:06d}": sorted(captures) for frame, captures in kept.items() if captures},
        "kept_because": "their identities are those that are asked for, and their files are whole",
    }


def _read_timings(out: Path) -> dict[str, dict[str, float]]:
    try:
        timings = dict(json.loads((out / TIMINGS_NAME).read_bytes()))
        return {name: seconds for name, seconds in timings.items() if name.isdecimal() and isinstance(seconds, dict)}
    except (OSError, ValueError, TypeError, RecursionError):
        return {}


FrameSeconds = tuple[int, dict[str, float]]


@dataclass(frozen=True)
class FrameRendering:
    """Makes the function that an executor calls for each frame; pickles."""

    plan: RenderPlan
    out: Path

    def __call__(self) -> Callable[[Work], FrameSeconds]:
        """Make the renderer, with one thread of torch, and return what renders a frame by it, with one thread, too."""
        with single_threaded():
            renderer = self.plan.make_renderer()

        def render(work: Work) -> FrameSeconds:
            with single_threaded():
                return work.frame, render_frame(self.plan, renderer, self.out, work)

        return render
