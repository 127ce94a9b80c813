"""The sweep of the sample's street that is run, and the command that runs it."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

LOG, SCENE, BASE = Path("out/street"), Path("sample/scene"), Path("sample/objects.json")
FRAMES = 20
FRAME_S = 0.1
FIRST_FRAME = 5
"""Of those that differ: the car is ahead of the vehicle then."""


def write_sweep(folder: Path, scenarios: int, frames_each: int, log: str = "", scene: str = "") -> Path:
    """Write a sweep whose variants differ in so many frames each; its path. A parked car, turned a little further in
    each, is there for these frames. ``log`` and ``scene`` are URLs in place of the folders' paths."""
    document = json.loads(BASE.read_text())
    car = {
        "type": "insert", "actor": "car-13", "id": "parked", "pose": {"position": [32.0, 6.2, 0.725], "yaw_deg": 180.0},
        "present": {
            "start_s": FRAME_S * (FIRST_FRAME - 0.4), "end_s": FRAME_S * (FIRST_FRAME + frames_each - 0.6)
        },
    }  # fmt: skip
    if frames_each >= FRAMES:
        del car["present"]
    document |= {
        "name": "kills", "log": log or os.path.relpath(LOG, folder), "scene": scene or os.path.relpath(SCENE, folder),
        "edits": [car], "outputs": {"formats": ["png", "labels"], "passes": ["rgb", "depth"]},
    }  # fmt: skip
    (folder / "base.json").write_text(json.dumps(document))
    turned = {"at": "/edits/0/pose/yaw_deg", "range": {"start": 170.0, "stop": 190.0, "count": scenarios}}
    sweep = {
        "format": "unisim-sweep", "version": 1, "name": "kills", "scenario": "base.json",
        "parameters": {"yaw": turned},
    }  # fmt: skip
    (folder / "sweep.json").write_text(json.dumps(sweep))
    return folder / "sweep.json"


def batch(sweep: Path, out: str, *more: str) -> list[str]:
    """The command of a batch, which prints its report as JSON."""
    return [
        sys.executable, "-m", "unisim_blender", "batch", str(sweep), "--out", out, "--unit", "10", "--width", "240",
        "--quality", "fast", "--json", *more,
    ]  # fmt: skip
