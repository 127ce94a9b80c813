"""The manifest of a rendered sequence: inputs, settings, and for each capture its identity, files and counts. It is
merged from the records of finished captures.

`drive.json` beside it is the drive that was rendered.
"""

from __future__ import annotations

import json
from collections.abc import Container, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

from ..errors import OutputError
from ..files import sha256_of_file, write_file
from ..formats.rendered import DRIVE_NAME, FORMAT
from ..json_file import json_bytes
from ..render.code_identity import code_identity
from ..render.quality import LADDER
from ..world.captures import CaptureKey, Moment, in_order, key_of, name_of, time_of_name
from ..world.drive import Appearance
from ..world.drive_json import drive_to_json
from .plan import RenderPlan

STATE_FOLDER = ".state"


@dataclass(frozen=True)
class CaptureRecord:
    """``identity`` is the digest of all that the capture depends on; ``sees`` are the ids of the actors that it can
    see; ``files`` are digests by path below the output folder; ``samples`` are counts, ``max_error`` the report of
    its error bounds."""

    identity: str
    files: Mapping[str, str]
    sees: tuple[str, ...] = ()
    samples: Mapping[str, int] = field(default_factory=dict)
    max_error: Mapping[str, Any] | None = None

    def is_whole(self, out: Path) -> bool:
        """Return whether all files exist and have the digests with which they were written."""
        return all(
            (out / name).is_file() and sha256_of_file(out / name) == digest for name, digest in self.files.items()
        )


Captures = dict[str, CaptureRecord]
"""By name: "camera/front_camera", "lidar/pandar64", "labels"."""


def finished_moments(out: Path, wanted: Container[CaptureKey] | None = None) -> int:
    """Count the finished moments of the sequence in folder ``out``: of all, or only of those ``wanted``."""
    return sum(1 for path in (out / STATE_FOLDER).glob("*.json") if wanted is None or _key(path) in wanted)


def read_records(out: Path) -> dict[CaptureKey, Captures]:
    """Return the captures of all moments, in order. A record that cannot be read is removed, and its captures
    count as missing."""
    found: dict[CaptureKey, Captures] = {}
    for path in sorted([*(out / STATE_FOLDER).glob("*.json"), *(out / STATE_FOLDER).glob("*.kept")]):
        try:
            captures = json.loads(path.read_bytes())["captures"]
            found[key_of(path.stem)] = {name: _record(values) for name, values in captures.items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            path.unlink(missing_ok=True)
    return {key: found[key] for key in in_order(found)}


def write_record(out: Path, key: CaptureKey, captures: Captures, finished: bool) -> None:
    """Write or replace the record of a moment; remove it if there are no captures. Raises `OutputError`."""
    record, kept = (out / STATE_FOLDER / f"{name_of(key)}{suffix}" for suffix in (".json", ".kept"))
    stale, path = (kept, record) if finished else (record, kept)
    if captures:
        document = {"frame": key, "captures": {name: asdict(captures[name]) for name in sorted(captures)}}
        write_file(path, json_bytes(document))
    else:
        path.unlink(missing_ok=True)
    stale.unlink(missing_ok=True)


def remove_files(out: Path, record: CaptureRecord) -> None:
    """Remove the files of a capture. Raises `OutputError`."""
    for name in record.files:
        try:
            (out / name).unlink(missing_ok=True)
        except OSError as error:
            raise OutputError(f"{out / name}: cannot be removed: {error.strerror}") from error


def _key(path: Path) -> CaptureKey | None:
    try:
        return key_of(path.stem)
    except ValueError:
        return None


def _record(values: dict[str, Any]) -> CaptureRecord:
    """Return a capture's record. Raises ValueError, KeyError or TypeError for values that a sequence never writes."""
    files, sees, samples, error = (
        dict(values["files"]),
        tuple(values["sees"]),
        dict(values["samples"]),
        values["max_error"],
    )
    if not all(_is_inside(name) and isinstance(digest, str) for name, digest in files.items()):
        raise ValueError("names a file elsewhere")
    if not all(isinstance(uid, str) for uid in sees) or {type(count) for count in samples.values()} - {int}:
        raise ValueError("counts no samples")
    if error is not None and (type(error["kept"]) is not bool or not isinstance(error["settings"], str)):
        raise ValueError("says nothing of its error")
    return CaptureRecord(str(values["identity"]), files, sees, samples, error)


def _is_inside(name: str) -> bool:
    """Return whether a record's file lies in the folder of frames; no other file may be removed."""
    path = PurePosixPath(name)
    return (
        bool(path.parts)
        and not path.is_absolute()
        and ".." not in path.parts
        and name.isprintable()
        and not {"\\", ":"} & set(name)
    )


MANIFEST_VERSION = 2
COUNTS = ("rays", "samples_spent", "samples_saved", "actors_skipped")
LABELS = "labels"
"""Name of a moment's labels among its captures."""


def make_manifest(plan: RenderPlan, out: Path, last_run: dict[str, Any]) -> dict[str, Any]:
    """Return the manifest of what is in folder ``out``."""
    records = read_records(out)
    moments = {name_of(key): captures for key, captures in records.items()}
    every = [record for captures in moments.values() for record in captures.values()]
    return {
        "format": FORMAT,
        "version": MANIFEST_VERSION,
        "code": code_identity(),
        "environment": plan.environment,
        "inputs": {**plan.about, "scenes": {"own": plan.scenes.get(""), "others": _other_scenes(plan)}},
        "settings": asdict(plan.settings),
        "samples": {name: sum(record.samples.get(name, 0) for record in every) for name in COUNTS},
        **_bounded(plan, moments),
        "frames": {
            name: {part: _told(record) for part, record in captures.items()} for name, captures in moments.items()
        },
        "times": {name_of(key): _times(plan, key, captures) for key, captures in records.items()},
        "last_run": last_run,
    }


def write_drive(plan: RenderPlan, out: Path) -> None:
    """Write the plan's drive with the sensors that are rendered, at the size they are rendered at. Raises `OutputError`.

    It has no times of captures, which the manifest has: so it is the same whichever are rendered.
    """
    drive, settings = plan.drive, plan.settings
    cameras, lidars = {}, {}
    for name in settings.cameras:
        camera = drive.cameras[name]
        model = camera.model if settings.width is None else camera.model.resized(settings.width)
        cameras[name] = replace(camera, model=model, time_s={})
    for name in settings.lidars:
        lidars[name] = replace(drive.lidars[name], time_s={})
    # what actors look like is a matter of scenes and meshes, which lie elsewhere
    actors = {uid: replace(actor, appearance=Appearance(uid)) for uid, actor in drive.actors.items()}
    rendered = replace(drive, frames=(), time_s={}, cameras=cameras, lidars=lidars, actors=actors)
    write_file(out / DRIVE_NAME, json_bytes(drive_to_json(rendered)))


def _times(plan: RenderPlan, key: CaptureKey, captures: Captures) -> dict[str, float]:
    """Return a moment's time, and those of its captures by name, in seconds."""
    drive = plan.drive
    if isinstance(key, int):
        moment = plan.moment_of_frame(key)
    else:
        moment = Moment.at(
            drive,
            time_of_name(key),
            [name for name in drive.cameras if f"camera/{name}" in captures],
            [name for name in drive.lidars if f"lidar/{name}" in captures],
        )
    found = {"time_s": moment.time_s(drive)}
    found |= {f"camera/{one.sensor_id}": one.time_s(drive.cameras[one.sensor_id]) for one in moment.cameras}
    found |= {f"lidar/{one.sensor_id}": one.time_s(drive.lidars[one.sensor_id]) for one in moment.lidars}
    return {name: time for name, time in found.items() if name == "time_s" or name in captures}


def _told(record: Any) -> dict[str, Any]:
    """Return a capture's entry in the manifest, without its errors, which have an entry of their own."""
    return {
        name: value for name, value in asdict(record).items() if name != "max_error" and (value or name == "identity")
    }


def _bounded(plan: RenderPlan, moments: dict[str, Captures]) -> dict[str, Any]:
    """Return the manifest's entry about error bounds; empty if there are none."""
    if not plan.settings.max_error:
        return {}
    of_moments = {
        moment: {name: record.max_error for name, record in captures.items() if record.max_error}
        for moment, captures in moments.items()
    }
    every = [(f"{moment}: {name}", said) for moment, of in of_moments.items() for name, said in of.items()]
    broken = [name for name, said in every if not said["kept"]]
    used = {said["settings"] for _, said in every}
    return {
        "max_error": {
            "bounds": list(plan.settings.max_error),
            "kept": not broken,
            "not_kept": broken,
            "settings": {name: asdict(quality) for name, quality in LADDER.items() if name in used},
            "frames": of_moments,
        }
    }


def _other_scenes(plan: RenderPlan) -> list[str]:
    return sorted(digest for name, digest in plan.scenes.items() if name)
