"""The manifest of a rendered sequence: inputs, settings, and for each capture its identity, files and counts."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..render.code_identity import code_identity
from ..render.quality import LADDER
from .plan import RenderPlan
from .records import Captures, read_records

MANIFEST_VERSION = 2
COUNTS = ("rays", "samples_spent", "samples_saved", "actors_skipped")
LABELS = "labels"
"""Name of a frame's labels among its captures."""


def make_manifest(plan: RenderPlan, out: Path, last_run: dict[str, Any]) -> dict[str, Any]:
    """Return the manifest of what is in folder ``out``."""
    frames = {f"{frame:06d}": captures for frame, captures in read_records(out).items()}
    every = [record for captures in frames.values() for record in captures.values()]
    return {
        "format": "unisim-render",
        "version": MANIFEST_VERSION,
        "code": code_identity(),
        "environment": plan.environment,
        "inputs": {**plan.about, "scenes": {"own": plan.scenes.get(""), "others": _other_scenes(plan)}},
        "settings": asdict(plan.settings),
        "samples": {name: sum(record.samples.get(name, 0) for record in every) for name in COUNTS},
        **_bounded(plan, frames),
        "frames": {name: {part: _told(record) for part, record in captures.items()} for name, captures in frames.items()},
        "last_run": last_run,
    }


def _told(record: Any) -> dict[str, Any]:
    """Return what the manifest says of a capture; errors stand apart."""
    return {name: value for name, value in asdict(record).items() if name != "max_error" and (value or name == "identity")}


def _bounded(plan: RenderPlan, frames: dict[str, Captures]) -> dict[str, Any]:
    """Return what the manifest says of the errors that were to be kept to; nothing where none were."""
    if not plan.settings.max_error:
        return {}
    of_frames = {
        frame: {name: record.max_error for name, record in captures.items() if record.max_error}
        for frame, captures in frames.items()
    }
    every = [(f"{frame}: {name}", said) for frame, of in of_frames.items() for name, said in of.items()]
    broken = [name for name, said in every if not said["kept"]]
    used = {said["settings"] for _, said in every}
    return {
        "max_error": {
            "bounds": list(plan.settings.max_error),
            "kept": not broken,
            "not_kept": broken,
            "settings": {name: asdict(quality) for name, quality in LADDER.items() if name in used},
            "frames": of_frames,
        }
    }


def _other_scenes(plan: RenderPlan) -> list[str]:
    return sorted(digest for name, digest in plan.scenes.items() if name)
