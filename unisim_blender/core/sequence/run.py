"""Frames of one drive rendered into a folder, by one or several processes, and taken up again where a run was cut off.

Every finished frame leaves a record of what it was rendered from and of its files' hashes, written after the files. A frame whose
record and files agree with what is asked for is not rendered again. The manifest is made of the records, so it does not depend on
how often or where a run was interrupted. Every process renders with one thread of torch: where torch cuts an array among threads
it changes the last bit of what lies at the cuts, and the bytes must not depend on threads.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from ..errors import OutputError
from ..files import remove_partial_files, sha256_of_file, write_file
from ..frames import RenderStats
from ..output.frame_files import json_bytes, write_camera, write_labels, write_lidar
from ..processes import THREAD_VARIABLES, end_with_parent
from ..quality import LADDER
from .plan import FrameRenderer, RenderPlan, code_identity, plan_key
from .records import STATE_FOLDER

MANIFEST_NAME = "manifest.json"
TIMINGS_NAME = "timings.json"
MANIFEST_VERSION = 1
COUNTS = ("rays", "samples_spent", "samples_saved", "actors_skipped")


@dataclass(frozen=True)
class RenderReport:
    """What a run did: frames rendered now, frames found finished, wall-clock seconds, and which sensors of which frames do not
    keep the error that was asked for."""

    rendered: tuple[int, ...]
    kept: tuple[int, ...]
    seconds: float
    broken: tuple[str, ...] = ()


def render_sequence(
    plan: RenderPlan,
    out: Path,
    jobs: int = 1,
    resume: bool = False,
    on_frame: Callable[[int], object] = lambda frame: None,
    on_kept: Callable[[int], object] = lambda count: None,
) -> RenderReport:
    """Render the plan's frames into folder ``out`` and write its manifest.

    ``on_kept`` is called once with the number of frames that were finished before, ``on_frame`` after each frame.

    Raises `OutputError` where ``out`` holds something already and ``resume`` is not set, or where it cannot be written; finished
    frames stay in every case.
    """
    started = time.monotonic()
    if not resume and out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(f"{out}: is not empty; name another folder, or continue the render it holds with --resume")
    key = plan_key(plan)
    remove_partial_files(out)
    kept = _discard_stale(out, key)
    to_do = [frame for frame in plan.frames if frame not in kept]
    if to_do:
        (out / MANIFEST_NAME).unlink(missing_ok=True)
    timings = _read_timings(out)
    on_kept(len(plan.frames) - len(to_do))
    try:
        run = _render_in_processes if jobs > 1 and len(to_do) > 1 else _render_here
        for frame, seconds in run(plan, out, key, to_do, jobs):
            timings[str(frame)] = seconds
            on_frame(frame)
    finally:
        remove_partial_files(out)
        if out.is_dir():
            write_file(out / TIMINGS_NAME, json_bytes({name: timings[name] for name in sorted(timings, key=int)}))
    manifest = _manifest(plan, out, key)
    write_file(out / MANIFEST_NAME, json_bytes(manifest))
    done = tuple(frame for frame in plan.frames if frame in kept)
    broken = tuple(manifest.get("max_error", {}).get("not_kept", ()))
    return RenderReport(tuple(to_do), done, time.monotonic() - started, broken)


def render_frame(plan: RenderPlan, renderer: FrameRenderer, out: Path, key: str, frame: int) -> dict[str, float]:
    """Render one frame's sensors, write its files and then its record; seconds taken by sensor."""
    settings, files, samples, seconds = plan.settings, [], {}, {}
    promises: dict[str, Any] = {}
    for name in settings.cameras:
        if frame not in plan.drive.cameras[name].time_s:
            continue
        started = time.monotonic()
        image = renderer.camera(name, frame, settings.passes, settings.width)
        files += write_camera(out, name, frame, plan.drive.cameras[name].time_s[frame], image, settings.formats)
        samples[f"camera/{name}"], seconds[f"camera/{name}"] = _counts(image.stats), time.monotonic() - started
        promises |= {} if image.promise is None else {f"camera/{name}": image.promise.to_json()}
    for name in settings.lidars:
        if frame not in plan.drive.lidars[name].time_s:
            continue
        started = time.monotonic()
        sweep = renderer.lidar(name, frame)
        files += write_lidar(out, name, frame, plan.drive.lidars[name].time_s[frame], sweep, settings.formats)
        samples[f"lidar/{name}"], seconds[f"lidar/{name}"] = _counts(sweep.stats), time.monotonic() - started
        promises |= {} if sweep.promise is None else {f"lidar/{name}": sweep.promise.to_json()}
    if "labels" in settings.formats:
        files += write_labels(out, plan.drive, frame)
    hashes = {path.relative_to(out).as_posix(): sha256_of_file(path) for path in files}
    record = {"frame": frame, "key": key, "files": hashes, "samples": samples, "max_error": promises}
    write_file(_record_path(out, frame), json_bytes(record))
    return seconds


def _counts(stats: RenderStats) -> dict[str, int]:
    return {name: getattr(stats, name) for name in COUNTS}


def _record_path(out: Path, frame: int) -> Path:
    return out / STATE_FOLDER / f"{frame:06d}.json"


def _records(out: Path) -> dict[int, dict[str, Any]]:
    """All frames' records in order; a record that is broken counts as none."""
    found = {}
    for path in sorted((out / STATE_FOLDER).glob("*.json")):
        try:
            found[int(path.stem)] = _record_of(json.loads(path.read_bytes()))
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            path.unlink(missing_ok=True)
    return found


def _record_of(document: Any) -> dict[str, Any]:
    """A record's parts. Raises ValueError, KeyError or TypeError for what `render_frame` does not write."""
    record = {"key": document["key"], **{part: dict(document[part]) for part in ("files", "samples", "max_error")}}
    if not all(_is_inside(name) and isinstance(digest, str) for name, digest in record["files"].items()):
        raise ValueError("names a file elsewhere")
    for counts in record["samples"].values():
        if {type(counts[name]) for name in COUNTS} != {int}:
            raise ValueError("counts no samples")
    for promise in record["max_error"].values():
        if type(promise["kept"]) is not bool or promise["settings"] not in LADDER:
            raise ValueError("promises nothing")
    return record


def _is_inside(name: str) -> bool:
    """Whether a record's file lies in the folder of frames: others are none of this program's to remove."""
    path = PurePosixPath(name)
    return (
        bool(path.parts)
        and not path.is_absolute()
        and ".." not in path.parts
        and name.isprintable()
        and not {"\\", ":"} & set(name)
    )


def _is_whole(out: Path, record: dict[str, Any]) -> bool:
    return all((out / name).is_file() and sha256_of_file(out / name) == digest for name, digest in record["files"].items())


def _discard_stale(out: Path, key: str) -> set[int]:
    """Remove frames that were rendered from other inputs or that are damaged; the frames that may stay."""
    kept = set()
    for frame, record in _records(out).items():
        if record["key"] == key and _is_whole(out, record):
            kept.add(frame)
            continue
        _record_path(out, frame).unlink()
        for name in record["files"]:
            (out / name).unlink(missing_ok=True)
    return kept


def _manifest(plan: RenderPlan, out: Path, key: str) -> dict[str, Any]:
    frames = {f"{frame:06d}": record for frame, record in _records(out).items()}
    totals = dict.fromkeys(COUNTS, 0)
    for record in frames.values():
        for counts in record["samples"].values():
            for name in totals:
                totals[name] += counts[name]
    return {
        "format": "unisim-render",
        "version": MANIFEST_VERSION,
        "code": code_identity(),
        "environment": plan.environment,
        "inputs": {**plan.about, "scenes": {"own": plan.scenes.get(""), "others": _other_scenes(plan)}, "key": key},
        "settings": asdict(plan.settings),
        "samples": totals,
        **_promised(plan, frames),
        "frames": {name: {"files": record["files"], "samples": record["samples"]} for name, record in frames.items()},
    }


def _promised(plan: RenderPlan, frames: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """What the manifest says of the errors that were to be kept to; nothing where none were."""
    if not plan.settings.max_error:
        return {}
    promises = {name: record["max_error"] for name, record in frames.items()}
    broken = [f"{name}: {sensor}" for name, of in promises.items() for sensor, promise in of.items() if not promise["kept"]]
    used = {promise["settings"] for of in promises.values() for promise in of.values()}
    return {
        "max_error": {
            "bounds": list(plan.settings.max_error),
            "kept": not broken,
            "not_kept": broken,
            "settings": {name: asdict(quality) for name, quality in LADDER.items() if name in used},
            "frames": promises,
        }
    }


def _other_scenes(plan: RenderPlan) -> list[str]:
    return sorted(digest for name, digest in plan.scenes.items() if name)


def _read_timings(out: Path) -> dict[str, dict[str, float]]:
    try:
        timings = dict(json.loads((out / TIMINGS_NAME).read_bytes()))
        return {name: seconds for name, seconds in timings.items() if name.isdecimal() and isinstance(seconds, dict)}
    except (OSError, ValueError, TypeError, RecursionError):
        return {}


FrameSeconds = tuple[int, dict[str, float]]


def _render_here(plan: RenderPlan, out: Path, key: str, frames: list[int], jobs: int) -> Iterator[FrameSeconds]:
    if not frames:
        return
    with single_threaded():
        renderer = plan.make_renderer()
        for frame in frames:
            yield frame, render_frame(plan, renderer, out, key, frame)


def _render_in_processes(plan: RenderPlan, out: Path, key: str, frames: list[int], jobs: int) -> Iterator[FrameSeconds]:
    with _pool(min(jobs, len(frames)), (plan, out, key)) as pool:
        waiting: set[Future[FrameSeconds]] = {pool.submit(_worker_frame, frame) for frame in frames}
        while waiting:
            finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in finished:
                try:
                    yield future.result()
                except BrokenProcessPool as error:
                    raise OutputError(
                        f"{out}: a render process was ended from outside (out of memory?); finished frames are kept, "
                        "continue with --resume and fewer --jobs"
                    ) from error


@contextmanager
def _pool(jobs: int, arguments: tuple[RenderPlan, Path, str]) -> Iterator[ProcessPoolExecutor]:
    """Worker processes; where the body fails or is interrupted they end at once, in the middle of their frames."""
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _start_worker, arguments)
    try:
        yield pool
    except BaseException:
        for process in list((getattr(pool, "_processes", None) or {}).values()):
            process.kill()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


_threads = ExitStack()
_worker: tuple[RenderPlan, FrameRenderer, Path, str] | None = None
"""What a worker process renders with, made once when it starts."""


def _start_worker(plan: RenderPlan, out: Path, key: str) -> None:
    global _worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides
    end_with_parent()
    for name in THREAD_VARIABLES:
        os.environ[name] = "1"  # for libraries that are imported from here on
    _threads.enter_context(single_threaded())
    _worker = plan, plan.make_renderer(), out, key


def _worker_frame(frame: int) -> FrameSeconds:
    assert _worker is not None
    plan, renderer, out, key = _worker
    return frame, render_frame(plan, renderer, out, key, frame)


@contextmanager
def single_threaded() -> Iterator[None]:
    """Let torch, where it has been imported, use one thread."""
    torch = sys.modules.get("torch")
    if torch is None:
        yield
        return
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
