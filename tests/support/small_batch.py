"""A street of three small frames, and a sweep over a second car that is there in the last of them alone."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from unisim_blender.core.cli.main import run

OPTIONS = ("--renderer", "surfel", "--quality", "fast", "--unit", "1", "--on", "this-process")
SECOND = {
    "type": "duplicate",
    "actor": "car-01",
    "id": "second",
    "pose": {"position": [14.0, 0.0, 0.8]},
    "present": {"start_s": 0.12},
}


def write_batch(folder: Path, street: Path, log: str = "street", **outputs: Any) -> Path:
    """Write a copy of a street, and `base.json` and `sweep.json` of two variants, whose log has this name; the folder."""
    shutil.copytree(street, folder / "street", dirs_exist_ok=True)
    base = {
        "format": "unisim-scenario", "version": 1, "name": "base", "log": log, "edits": [SECOND], "outputs": outputs,
        "simulation": {"duration_s": 0.1},
    }  # fmt: skip
    (folder / "base.json").write_text(json.dumps(base))
    parameters = {"aside": {"at": "/edits/0/pose/position/1", "values": [1.0, 2.0]}}
    sweep = {"format": "unisim-sweep", "version": 1, "name": "cars", "scenario": "base.json", "parameters": parameters}
    (folder / "sweep.json").write_text(json.dumps(sweep))
    return folder


def batch(jobs: Path | str, out: Path | str, *more: str) -> int:
    """Run `unisim batch` in this process; its exit status."""
    return run(["batch", str(jobs), "--out", str(out), *OPTIONS, *more])


def files(folder: Path) -> dict[str, bytes]:
    """Return the bytes of all files below a folder, by their names."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
