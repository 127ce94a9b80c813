"""What is in a folder that a sequence was rendered into."""

from __future__ import annotations

import json
from pathlib import Path


def contents(folder: Path) -> dict[str, bytes]:
    """Return every file's bytes by its name, but the timings and what the manifest says of the last run."""
    found = {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "timings.json"
    }
    if "manifest.json" in found:
        manifest = json.loads(found["manifest.json"])
        del manifest["last_run"]
        found["manifest.json"] = json.dumps(manifest, indent=1).encode()
    return found


def captures(folder: Path) -> dict[str, bytes]:
    """Return the bytes of all images, sweeps and labels by their files' names."""
    kinds = ("camera", "lidar", "labels")
    found = [path for kind in kinds for path in sorted((folder / kind).rglob("*")) if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}
