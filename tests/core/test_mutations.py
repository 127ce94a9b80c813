"""A few files with random faults for every reader, in a process of its own with bounded memory.

UNISIM_MUTATIONS=100000 runs so many in all.
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from unisim_blender.core.compare.run import _earlier
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.worker.protocol import LENGTH, read_message

SCRIPT = Path(__file__).parent / "mutations" / "run.py"
COUNT = int(os.environ.get("UNISIM_MUTATIONS", "340"))
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no alarms and no bounds of memory there")


def test_readers_read_or_refuse_in_one_sentence() -> None:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    command = [sys.executable, str(SCRIPT), "--count", str(COUNT)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode in (0, 1), f"{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
    figures = json.loads(done.stdout.splitlines()[-1])
    assert len(figures) >= 15 and all(of["inputs"] >= COUNT / len(figures) for of in figures.values())
    assert not {name: of["failures"] for name, of in figures.items() if of["failures"]}, done.stdout[-4000:]


@pytest.mark.parametrize("data", (b"[" * 100_000, b"[1]", b"\xff", b"{", b""))
def test_a_message_that_is_none_ends_the_worker_quietly(data: bytes) -> None:
    assert read_message(io.BytesIO(LENGTH.pack(len(data)) + data)) is None
    assert read_message(io.BytesIO(LENGTH.pack(len(data) + 1) + data)) is None


@pytest.mark.parametrize("text", ("[" * 100_000, "[]", '{"about": 3, "rows": {}}', '{"about": {}, "rows": [1]}', "\x00"))
def test_a_table_that_is_none_is_refused_by_name(text: str, tmp_path: Path) -> None:
    path = tmp_path / "comparison.json"
    path.write_text(text)
    with pytest.raises(UnisimError, match=r"comparison\.json: is no comparison: ") as caught:
        _earlier(path, {"log": "a"})
    assert "\n" not in str(caught.value)
