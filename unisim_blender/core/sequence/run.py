"""Render captures of one drive into a folder, in one or several processes; interrupted runs can be resumed.

Each finished capture has a record of its identity and of its files' digests, written after the files. A capture is
rendered again only if its record or files differ from what is asked for. The manifest is built from the records: apart
from its entry about the last run, it does not depend on how often or where a run was interrupted. Every process renders
with one thread of torch, because torch's results differ in the last bit with the number of threads.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..errors import OutputError
from ..executors import Executor, usual_executor
from ..executors.executor import ProcessLost, results_of
from ..files import holds_out, remove_partial_files, sha256_of_file, write_file
from ..formats.rendered import labels_path
from ..json_file import json_bytes
from ..output.frame_files import labels_bytes, write_camera, write_labels, write_lidar
from ..processes import single_threaded
from ..render.bounded import BoundedRenderer
from ..render.captures import StartCapture, start_capture, started_ahead
from ..render.renderer import Renderer
from ..render.reuse import FrameReuse
from ..sensors.error_bound import parse_bounds
from ..sensors.frames import CameraFrame, LidarFrame
from ..world.captures import CaptureKey, Moment, in_order, key_of, name_of, time_of_name
from .manifest import COUNTS, LABELS, make_manifest, write_drive
from .plan import CaptureIdentities, Identity, RenderPlan
from .records import CaptureRecord, Captures, read_records, remove_files, write_record

MANIFEST_NAME = "manifest.json"
TIMINGS_NAME = "timings.json"


@dataclass(frozen=True)
class RenderReport:
    """Result of a run.

    ``rendered`` are the moments with captures rendered by this run, ``kept`` those that were finished before;
    ``captures`` and ``captures_kept`` count the captures. ``seconds`` is wall-clock time. ``broken`` names the captures
    that miss an error bound.
    """

    rendered: tuple[CaptureKey, ...]
    kept: tuple[CaptureKey, ...]
    seconds: float
    broken: tuple[str, ...] = ()
    captures: int = 0
    captures_kept: int = 0


@holds_out
def render_sequence(
    plan: RenderPlan,
    out: Path,
    jobs: int = 1,
    resume: bool = False,
    on_moment: Callable[[CaptureKey], object] = lambda key: None,
    on_reused: Callable[[int], object] = lambda count: None,
    executor: Executor | None = None,
) -> RenderReport:
    """Render the plan's moments into folder ``out`` and write its manifest.

    Captures that are there and have the identity that is asked for are kept (`identity.py`): after an edit, only those
    that can see it are rendered again. ``on_reused`` is called once with the number of finished moments, ``on_moment``
    after each further one. ``executor`` renders ``jobs`` moments at a time; None is this process, or a pool of ``jobs``
    processes.

    Raises `OutputError` if ``out`` is not empty and ``resume`` is not set, or if it cannot be written. Finished
    captures are kept in every case.
    """
    started = time.monotonic()
    if not resume and out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(f"{out}: is not empty; name another folder, or continue the render it holds with --resume")
    remove_partial_files(out)
    identities = CaptureIdentities(plan)
    reusable = reusable_captures(plan, out, identities)
    work = [Work(moment, identities.of_moment(moment), reusable.get(moment.key, {})) for moment in plan.moments]
    work = [item for item in work if item.to_render or not item.reusable]
    to_do = [item.moment.key for item in work]
    if to_do:
        (out / MANIFEST_NAME).unlink(missing_ok=True)
    relabelled = _write_labels(plan, out, identities, reusable)
    timings = _read_timings(out)
    on_reused(len(plan.moments) - len(to_do))
    try:
        executor = executor or usual_executor(jobs, len(work))
        with closing(results_of(executor.run(partial(moment_renderer, plan, out), work, jobs))) as results:
            for key, seconds in results:
                timings[key] = {**timings.get(key, {}), **seconds}
                on_moment(key)
    except ProcessLost as error:
        raise OutputError(
            f"{out}: {error}; finished frames are kept, continue with --resume and fewer --jobs"
        ) from error
    finally:
        remove_partial_files(out)
        if out.is_dir():
            write_file(out / TIMINGS_NAME, json_bytes({str(key): timings[key] for key in in_order(timings)}))
    write_drive(plan, out)
    manifest = make_manifest(plan, out, _last_run(work, reusable, relabelled))
    write_file(out / MANIFEST_NAME, json_bytes(manifest))
    done = tuple(moment.key for moment in plan.moments if moment.key not in to_do)
    broken = tuple(manifest.get("max_error", {}).get("not_kept", ()))
    captures = sum(len(item.to_render) for item in work)
    there = sum(len(reusable.get(moment.key, {}).keys() - {LABELS}) for moment in plan.moments)
    return RenderReport(tuple(to_do), done, time.monotonic() - started, broken, captures, there)


@dataclass(frozen=True)
class Work:
    """A moment to render. ``wanted`` maps the names of its captures to their identities and the actors that they see;
    ``reusable`` are the records of captures that need not be rendered."""

    moment: Moment
    wanted: Mapping[str, Identity]
    reusable: Captures

    @property
    def to_render(self) -> list[str]:
        """Names of the captures to render, cameras first."""
        return [name for name in self.wanted if name not in self.reusable]


def reusable_captures(plan: RenderPlan, out: Path, identities: CaptureIdentities) -> dict[CaptureKey, Captures]:
    """Remove captures whose identity differs from what is asked for, or whose files are damaged. Return the records of
    the others, by moment."""
    reusable: dict[CaptureKey, Captures] = {}
    asked = {moment.key: moment for moment in plan.moments}
    for key, captures in read_records(out).items():
        moment = asked.get(key) or _moment_there(plan, key, captures)
        wanted = (
            {} if moment is None else {name: identity for name, (identity, _) in identities.of_moment(moment).items()}
        )
        if "labels" in plan.settings.formats and moment is not None:
            wanted[LABELS] = labels_record(plan, moment).identity
        holds = {
            name: record
            for name, record in captures.items()
            if wanted.get(name) == record.identity and record.is_whole(out)
        }
        if key not in asked and wanted.keys() - holds.keys():
            holds = {}  # nobody would finish it
        for name in captures.keys() - holds.keys():
            remove_files(out, captures[name])
        reusable[key] = holds
        if len(holds) < len(captures):
            write_record(out, key, holds, finished=not wanted.keys() - holds.keys())
    return reusable


def _moment_there(plan: RenderPlan, key: CaptureKey, captures: Captures) -> Moment | None:
    """Return a moment of the folder that the plan does not have, with the plan's sensors: all of a frame of the log, or
    those that were captured at a time. None for frames that the drive lacks."""
    settings, drive = plan.settings, plan.drive
    if isinstance(key, int):
        return plan.moment_of_frame(key) if key in drive.time_s else None
    cameras, lidars = (
        [name for name in names if f"{kind}/{name}" in captures]
        for kind, names in (("camera", settings.cameras), ("lidar", settings.lidars))
    )
    return Moment.at(drive, time_of_name(key), cameras, lidars)


def _write_labels(
    plan: RenderPlan, out: Path, identities: CaptureIdentities, reusable: Mapping[CaptureKey, Captures]
) -> list[CaptureKey]:
    """Write the labels of moments whose captures are all kept; return the moments whose labels were written."""
    changed = []
    for moment in plan.moments if "labels" in plan.settings.formats else ():
        captures = reusable.get(moment.key, {})
        if captures and LABELS not in captures and not identities.of_moment(moment).keys() - captures.keys():
            write_labels(out, plan.drive, moment)
            write_record(out, moment.key, {**captures, LABELS: labels_record(plan, moment)}, finished=True)
            changed.append(moment.key)
    return changed


def labels_record(plan: RenderPlan, moment: Moment) -> CaptureRecord:
    """Return the record of a moment's labels. Their identity is the digest of their content."""
    digest = hashlib.sha256(labels_bytes(plan.drive, moment)).hexdigest()
    return CaptureRecord(digest, {labels_path(Path(), moment.name).as_posix(): digest})


def render_moment(
    plan: RenderPlan,
    start: StartCapture,
    out: Path,
    work: Work,
    on_capture: Callable[[str, CameraFrame | LidarFrame, CaptureRecord], object] = lambda name, shot, record: None,
) -> dict[str, float]:
    """Render a moment's missing captures, write their files, then the moment's record. Return the
    seconds by capture. ``on_capture`` is called with each one that was rendered and written."""
    settings, moment, seconds = plan.settings, work.moment, {}
    of, sensors = moment.captures, plan.drive.sensors
    captures = {name: record for name, record in work.reusable.items() if name in work.wanted}
    ahead = started_ahead(start, (of[name] for name in work.to_render))
    for name, waits in zip(work.to_render, ahead, strict=True):
        started = time.monotonic()
        capture = of[name]
        shot, time_s = waits(), capture.time_s(sensors[capture.sensor_id])
        if isinstance(shot, CameraFrame):
            files = write_camera(out, moment.name, capture, time_s, shot, settings.formats)
        else:
            files = write_lidar(out, moment.name, capture, time_s, shot, settings.formats)
        identity, sees = work.wanted[name]
        digests = {path.relative_to(out).as_posix(): sha256_of_file(path) for path in files}
        error = None if shot.error_bound is None else shot.error_bound.to_json()
        counts = {count: getattr(shot.stats, count) for count in COUNTS}
        captures[name] = CaptureRecord(identity, digests, sees, counts, error)
        write_record(out, moment.key, captures, finished=False)
        on_capture(name, shot, captures[name])
        seconds[name] = time.monotonic() - started
    if "labels" in settings.formats:
        write_labels(out, plan.drive, moment)
        captures[LABELS] = labels_record(plan, moment)
    write_record(out, moment.key, captures, finished=True)
    return seconds


def _last_run(
    work: Sequence[Work], reusable: Mapping[CaptureKey, Captures], relabelled: Sequence[CaptureKey]
) -> dict[str, Any]:
    """Return the manifest's entry about the last run: what was rendered, what was kept, and why."""
    return {
        "rendered": {item.moment.name: item.to_render for item in work},
        "labels_alone": [name_of(key) for key in relabelled],
        "kept": {name_of(key): sorted(captures) for key, captures in reusable.items() if captures},
        "kept_because": "their identities are those that are asked for, and their files are whole",
    }


def _read_timings(out: Path) -> dict[CaptureKey, dict[str, float]]:
    try:
        timings = dict(json.loads((out / TIMINGS_NAME).read_bytes()))
        return {key_of(name): seconds for name, seconds in timings.items() if isinstance(seconds, dict)}
    except (OSError, ValueError, TypeError, RecursionError):
        return {}


MomentSeconds = tuple[CaptureKey, dict[str, float]]


def moment_renderer(plan: RenderPlan, out: Path) -> Callable[[Work], MomentSeconds]:
    """Load the plan's renderer, and return the function that renders a moment with it, both with one thread of torch."""
    with single_threaded():
        start = capture_renderer(plan, plan.recipe.load())

    def render(work: Work) -> MomentSeconds:
        with single_threaded():
            return work.moment.key, render_moment(plan, start, out, work)

    return render


def capture_renderer(plan: RenderPlan, renderer: Renderer, reuse: FrameReuse | None = None) -> StartCapture:
    """Return what begins a plan's captures by its settings (`start_capture`)."""
    settings = plan.settings
    if settings.max_error:
        bounded = BoundedRenderer(renderer, plan.captures, parse_bounds(settings.max_error), settings.draw)
        return partial(partial, bounded.render, passes=settings.passes, width=settings.width)
    return partial(
        start_capture,
        renderer,
        plan.captures,
        passes=settings.passes,
        width=settings.width,
        draw=settings.draw,
        reuse=reuse,
    )
