"""The cases of `stress/` at a small size, each within its bounds, and rendered files that never depend on threads."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from instruction_sets import sets_here
from random_scene import CARS, edited

from stress.cases import CASES
from stress.measures import Bench, Measure
from stress.scenes import make_scene
from stress.variants import compared_variants
from unisim_blender.core import native
from unisim_blender.core.errors import SceneError
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.model.scene_file import HEADER_NAME, WEIGHTS_NAME
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene

pytestmark = pytest.mark.stress
REFUSED = r"static\.grid\.table\[0, 0\] is not a finite number$"
RENDER = "import sys; from unisim_blender.core.cli.main import run; sys.exit(run(sys.argv[1:]))"


@pytest.mark.parametrize("name", CASES)
def test_bounds_are_kept(name: str, tmp_path: Path) -> None:
    measures = list(CASES[name](Bench(tmp_path)))
    assert measures
    assert not [f"{m.what}: {m.error:.3g}, not within {m.bound:.3g}" for m in measures if not m.kept]


def test_what_is_not_a_number_keeps_no_bound() -> None:
    assert not Measure("", float("nan"), np.inf).kept and Measure("", 1.0, 1.0).kept and not Measure("", 1.1, 1.0).kept


@pytest.mark.skipif(len(sets_here()) < 2, reason="one instruction set runs here")
def test_instruction_sets_agree(tmp_path: Path) -> None:
    measures = list(compared_variants(Bench(tmp_path)))
    assert len(measures) >= 4 and not [m for m in measures if not m.kept]


def test_tables_that_are_not_finite_are_refused_in_one_sentence(tmp_path: Path) -> None:
    folder = make_scene(tmp_path / "scene", edited(CARS))
    header = json.loads((folder / HEADER_NAME).read_text())
    header.pop("weights", None)
    (folder / HEADER_NAME).write_text(json.dumps(header))
    file = folder / WEIGHTS_NAME
    raw = bytearray(file.read_bytes())
    length = int.from_bytes(raw[:8], "little")
    names = json.loads(raw[8 : 8 + length])
    begin = 8 + length + names["static.grid.table"]["data_offsets"][0]
    for bits in (0x7E00, 0x7C00):
        raw[begin : begin + 2] = bits.to_bytes(2, "little")
        file.write_bytes(raw)
        with pytest.raises(SceneError, match=REFUSED):
            load_scene(folder)
        if native.library() is not None:
            with pytest.raises(SceneError, match=REFUSED):
                CompiledScene(folder)


def test_a_scenario_has_the_same_bytes_with_any_number_of_threads(tmp_path: Path) -> None:
    make_scene(tmp_path / "scene", edited(CARS))
    passes, formats = ["rgb", "depth", "normal", "instance", "opacity"], ["png", "exr", "npz", "labels"]
    document = {
        "format": "unisim-scenario", "version": 1, "name": "twice", "scene": "scene", "log": "none", "frames": [1, 2],
        "edits": [], "outputs": {"passes": passes, "formats": formats},
    }  # fmt: skip
    (tmp_path / "scenario.json").write_text(json.dumps(document))
    written = []
    for out, threads in (("one", "1"), ("again", "1"), ("three", "3")):
        asked = [
            "render",
            str(tmp_path / "scenario.json"),
            "--out",
            str(tmp_path / out),
            "--jobs",
            "1",
            "--device",
            "cpu",
        ]
        environment = {**os.environ, "OMP_NUM_THREADS": threads}
        command = [sys.executable, "-c", RENDER, *asked]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
        files = sorted(path for path in (tmp_path / out).rglob("*") if path.is_file() and path.name != "timings.json")
        written.append({str(path.relative_to(tmp_path / out)): path.read_bytes() for path in files})
    assert len(written[0]) > 8
    assert written[1] == written[0] and written[2] == written[0]
