"""A batch onto a disk that becomes full: one sentence, nothing half written, and it is resumed once there is room."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import small_batch
from small_batch import batch, files, write_batch

OPTIONS = ("--sensors", "front_camera")
RUN = "import sys; from small_batch import batch; sys.exit(batch(*sys.argv[1:]))"
SCRIPT = """
set -u
disk=$1; copy=$2; shift 2
mount -t tmpfs -o size={size} none "$disk" || exit 99
"$@"; echo "$?" > "$copy/first"
cp -r "$disk/out" "$copy/first-out"
mount -o remount,size=16m "$disk" || exit 99
"$@" --resume; echo "$?" > "$copy/second"
cp -r "$disk/out" "$copy/second-out"
"""


def test_a_full_disk_leaves_nothing_half_written(small_street: Path, tmp_path: Path) -> None:
    write_batch(tmp_path, small_street, formats=["png", "labels"])
    assert batch(tmp_path / "sweep.json", tmp_path / "whole" / "out", *OPTIONS) == 0
    whole = files(tmp_path / "whole" / "out")
    (tmp_path / "disk").mkdir()
    half = sum(-(-len(data) // 4096) * 4096 for data in whole.values()) // 2
    words = [str(tmp_path / "disk"), str(tmp_path), sys.executable, "-c", RUN]
    words += [str(tmp_path / "sweep.json"), str(tmp_path / "disk" / "out"), *OPTIONS]
    path = os.pathsep.join([str(Path(small_batch.__file__).parent), os.environ.get("PYTHONPATH", "")])
    try:
        done = subprocess.run(
            ["unshare", "--mount", "sh", "-c", SCRIPT.format(size=half), "sh", *words],
            env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True,
        )  # fmt: skip
    except OSError as error:
        pytest.skip(f"there are no mount namespaces: {error}")
    if not (tmp_path / "first").exists():
        pytest.skip(f"a small disk cannot be mounted: {done.stderr.strip()}")
    assert (tmp_path / "first").read_text() == "1\n"
    (fault,) = [line for line in done.stderr.splitlines() if line.startswith("Error: ")]
    assert "No space left on device" in fault and "Traceback" not in done.stderr
    left = files(tmp_path / "first-out")
    assert 0 < len(left) < len(whole) and left.items() <= whole.items(), "what is there is whole"
    assert (tmp_path / "second").read_text() == "0\n", done.stderr
    assert files(tmp_path / "second-out") == whole
