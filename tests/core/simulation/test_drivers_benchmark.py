"""The benchmark of drivers: its table says what the scores say, and its comparisons find what differs."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from driven_record import record_of, straight, times
from written_street import write_street

from benchmarks.drivers.__main__ import main
from benchmarks.drivers.drivers import Entry
from benchmarks.drivers.same_bytes import compared, files_of, replay_check
from benchmarks.drivers.table import markdown
from unisim_blender.core.prepare.scenario_plan import RenderOptions
from unisim_blender.core.simulation.rollout.score import SCORES_NAME
from unisim_blender.core.simulation.rollout.setup import open_scenario
from unisim_blender.core.simulation.rollout.steps import read_steps
from unisim_blender.core.simulation.scores.summary import summarise

FIVE = times(5.0)


def scores(unsupported: float | None) -> dict[str, Any]:
    """Of an ego that runs into a car that stands; it is shown ever more of what nobody recorded."""
    shares = None if unsupported is None else tuple(np.linspace(0, unsupported, 51).tolist())
    ego = straight(FIVE, 0, 0, 0, 10)
    record = record_of(FIVE, ego, {"a": (straight(FIVE, 40.25, 0, 0, 0), (4.0, 2.0))}, unsupported_share=shares)
    return {"privileged": unsupported is None, **summarise(record)}


def cells(text: str, row: str) -> list[str]:
    return next(line for line in text.splitlines() if line.startswith(f"| {row} |")).strip("| ").split(" | ")[1:]


def test_the_table_says_what_the_scores_say() -> None:
    text = markdown({"one": scores(0.4), "two": scores(None), "three": scores(0.1)})
    assert text.splitlines()[0] == "| | `one` | `two`, privileged | `three` |"
    # the bumper is 3.25 m ahead of the rear axle, the car's rear at 38.25 m
    assert cells(text, "the first") == ["3.50 s, 10.00 m/s, Car, front, at fault"] * 3
    assert cells(text, "collisions, at fault") == ["1, 1"] * 3
    assert cells(text, "minimum TTC")[0].startswith("0.00 s at 3.5 s")
    assert cells(text, "unsupported above 20 % from") == ["2.6 s", "–", "never"]
    assert cells(text, "progress") == ["100% (50.0 of 50.0 m)"] * 3
    assert "- HD-score of `one`: the driver gave no plans." in text
    assert "- PDMS without `drivable_area_compliance`" in text
    assert "- unsupported pixels of `two`:" in text and "pixels of `one`:" not in text


def test_it_drives_and_finds_changed_bytes(tmp_path: Path) -> None:
    """The log lasts 0.2 s: `log` stops there, `idm` goes on."""
    log = write_street(tmp_path / "street", 3, 18, 400)
    out, options = tmp_path / "out", RenderOptions(renderer="surfel", quality="fast")
    asked = [str(log), "--out", str(out), "--driver", "log", "--driver", "idm", "--seconds", "0.3"]
    with pytest.raises(SystemExit) as ended:
        main([*asked, "--renderer", "surfel", "--period", "0.1"])
    assert ended.value.code == 0
    lasted = {name: read_steps(out / name)[-1].time_us for name in ("log", "idm")}
    assert lasted == {"log": 200_000, "idm": 300_000}
    assert cells((out / "table.md").read_text(), "simulated") == ["0.2 s, 2 steps", "0.3 s, 3 steps"]
    opened, entry = open_scenario(out / "asked.json", options), Entry("log", "log")
    found = replay_check(entry, out / "asked.json", opened, 0.2, out / "log", tmp_path / "replay", options)
    assert found.kept and found.files > 2
    other = shutil.copytree(out / "log", tmp_path / "other")
    (other / SCORES_NAME).write_text("{}")
    next((other / "camera").rglob("*.png")).unlink()
    differs = compared("", files_of(out / "log"), files_of(other))
    assert not differs.kept and len(differs.different) == 2
    assert not compared("", {}, {}).kept
