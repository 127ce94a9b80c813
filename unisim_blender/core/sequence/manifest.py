"""The manifest of a rendered sequence: inputs, settings, and for each capture its identity, files and counts.

`drive.json` beside it is the drive that was rendered.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from ..files import write_file
from ..formats.rendered import DRIVE_NAME, FORMAT
from ..json_file import json_bytes
from ..render.code_identity import code_identity
from ..render.quality import ERROR_BOUND_QUALITIES
from ..world.captures import CaptureKey, Moment, name_of, time_of_name
from ..world.drive import Appearance
from ..world.drive_json import drive_to_json
from .plan import RenderPlan
from .records import Captures, read_records

MANIFEST_VERSION = 2
COUNTS = ("rays", "samples_spent", "samples_saved", "actors_skipped")
LABELS = "labels"
"""Name of a moment's labels among its captures."""


def make_manifest(plan: RenderPlan, out: Path, last_run: dict[str, Any]) -> dict[str, Any]:
    """Return the manifest of what is in folder ``out``."""
    records = read_records(out)
    moments = {name_of(key): captures for key, captures in records.items()}
    every = [record for captures in moments.values() for record in captures.values()]
    others = sorted(digest for name, digest in plan.scenes.items() if name)
    return {
        "format": FORMAT,
        "version": MANIFEST_VERSION,
        "code": code_identity(),
        "environment": plan.environment,
        "inputs": {
            **plan.about,
            "scenes": {
                "own": plan.scenes.get(""),
                "others": others,
            },
        },
        "settings": asdict(plan.settings),
        "samples": {name: sum(record.samples.get(name, 0) for record in every) for name in COUNTS},
        **_bounded(plan, moments),
        "frames": {
            name: {part: _entry(record) for part, record in captures.items()} for name, captures in moments.items()
        },
        "times": {name_of(key): _times(plan, key, captures) for key, captures in records.items()},
        "last_run": last_run,
    }


def write_drive(plan: RenderPlan, out: Path) -> None:
    """Write the plan's drive with the sensors that are rendered, at the size they are rendered at. Raises `OutputError`.

    It has no times of captures, which the manifest has: so it is the same whichever are rendered.
    """
    drive, settings = plan.drive, plan.settings
    cameras = {}
    for name in settings.cameras:
        camera = drive.cameras[name]
        model = camera.model if settings.width is None else camera.model.resized(settings.width)
        cameras[name] = replace(camera, model=model, time_s={})
    lidars = {name: replace(drive.lidars[name], time_s={}) for name in settings.lidars}
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
    sensors = drive.sensors
    times = {name: capture.time_s(sensors[capture.sensor_id]) for name, capture in moment.captures.items()}
    return {"time_s": moment.time_s(drive), **{name: time for name, time in times.items() if name in captures}}


def _entry(record: Any) -> dict[str, Any]:
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
            "settings": {name: asdict(quality) for name, quality in ERROR_BOUND_QUALITIES.items() if name in used},
            "frames": of_moments,
        }
    }
