"""A .blend rendered by one command is what its exported scenario renders, byte for byte."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import bpy
from helpers import imported, select

ROOT = Path(__file__).parents[2]
SIZE = ["--frames", "4:6", "--width", "96", "--sensors"]


def files(folder: Path) -> dict[str, bytes]:
    """What a render wrote, but its times."""
    found = {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    return {name: data for name, data in found.items() if name != "timings.json"}


def test_the_same_bytes(street: Any, tmp_path: Path) -> None:
    uid = sorted(o.unisim.uid for o in street.objects if o.unisim.kind == "ACTOR")[0]
    select(imported(street, "ACTOR", uid))
    bpy.ops.unisim.delete_actor()
    bpy.ops.unisim.shift_ego(left_m=0.5)
    camera = street.camera.unisim.uid
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "drive.blend"))
    bpy.ops.unisim.export_scenario(filepath=str(tmp_path / "scenario.json"))
    for path, out in (("drive.blend", "a"), ("scenario.json", "b")):
        command = [sys.executable, "-m", "unisim_blender", "render", path, "--out", out, *SIZE, camera]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
    a, b = files(tmp_path / "a"), files(tmp_path / "b")
    assert len(a) > 4 and a == b


def test_a_missing_file_is_one_sentence(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "unisim_blender", "render", "none.blend", "--out", "a"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 1 and "none.blend" in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "a").exists()
