"""What `tools/compare_bytes.py` calls a difference, and what not."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from PIL import Image
from plyfile import PlyData, PlyElement
from safetensors.torch import save_file

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))

from byte_checks.cases import CASES, chosen  # noqa: E402
from byte_checks.difference import Intended, differences, files_of, read_intended  # noqa: E402

Write = Callable[[Path, float], None]


def _json(path: Path, value: float) -> None:
    path.write_text(json.dumps({"boxes": [{"id": "a", "at": [1.0, value]}]}))


def _png(path: Path, value: float) -> None:
    Image.fromarray(np.full((2, 3, 3), int(value), np.uint8)).save(path)


def _exr(path: Path, value: float) -> None:
    depth = np.full((2, 3), np.inf, np.float32)
    depth[1, 2] = value
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION}, {"depth": depth, "A": np.ones((2, 3), np.float16)}).write(
        str(path)
    )


def _npz(path: Path, value: float) -> None:
    np.savez(path, depth=np.array([1.0, value]), ring=np.arange(3))


def _ply(path: Path, value: float) -> None:
    points = np.array([(1.0, value)], [("x", "f4"), ("y", "f4")])
    PlyData([PlyElement.describe(points, "vertex")]).write(str(path))


def _safetensors(path: Path, value: float) -> None:
    save_file({"table": torch.tensor([1.0, value])}, path)


@pytest.mark.parametrize(
    "name, write, part",
    [
        ("frame.json", _json, "boxes[0].at[1]"),
        ("frame.png", _png, "pixels"),
        ("frame.exr", _exr, "depth"),
        ("frame.npz", _npz, "depth"),
        ("frame.ply", _ply, "y"),
        ("weights.safetensors", _safetensors, "table"),
    ],
)
def test_a_number_that_differs_is_named(tmp_path: Path, name: str, write: Write, part: str) -> None:
    for folder, value in (("a", 4.0), ("b", 4.0), ("c", 7.0)):
        (tmp_path / folder).mkdir()
        write(tmp_path / folder / name, value)
    assert differences(tmp_path / "a", tmp_path / "b") == []
    (found,) = differences(tmp_path / "a", tmp_path / "c")
    assert found.file == name and [p.name for p in found.parts] == [part]
    assert "by 3" in found.parts[0].how and f"{name}: {part}" in str(found)


def test_the_sign_of_nothing_and_of_a_nan_count(tmp_path: Path) -> None:
    for folder, values in (("a", [0.0, np.nan, np.inf]), ("b", [-0.0, 1.0, np.inf])):
        (tmp_path / folder).mkdir()
        np.savez(tmp_path / folder / "x.npz", depth=np.array(values))
    (found,) = differences(tmp_path / "a", tmp_path / "b")
    assert found.parts[0].how == "differs in 2 of 3 values by 0 at most, 1 are not finite in one"


def test_files_of_one_side_and_broken_ones_count(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        _npz(tmp_path / folder / "whole.npz", 1.0)
    (tmp_path / "a" / "gone.txt").write_text("x")
    (tmp_path / "b" / "new.txt").write_text("x")
    (tmp_path / "b" / "whole.npz").write_bytes(b"no archive")
    found = {difference.file: difference.parts[0].how for difference in differences(tmp_path / "a", tmp_path / "b")}
    assert found["gone.txt"] == "is in base alone" and found["new.txt"] == "is in head alone"
    assert found["whole.npz"].startswith("cannot be read")


def _sequence(folder: Path, value: float, code: str, indent: int | None = 1) -> None:
    (folder / ".state").mkdir(parents=True)
    _npz(folder / "000001.npz", value)
    record = {"files": {"000001.npz": f"digest of {value}"}, "samples": {"rays": 9}}
    manifest = {
        "code": {"version": "1", "sha256": code},
        "inputs": {"key": f"key of {code}"},
        "frames": {"000001": record},
    }
    (folder / ".state" / "000001.json").write_text(json.dumps({"key": f"key of {code}", **record}, indent=indent))
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=indent))
    (folder / "timings.json").write_text(json.dumps({"1": code}))


def test_the_codes_own_digests_do_not_count(tmp_path: Path) -> None:
    _sequence(tmp_path / "a", 1.0, "one")
    _sequence(tmp_path / "b", 1.0, "other")
    _sequence(tmp_path / "c", 1.0, "other", indent=None)
    assert "timings.json" not in files_of(tmp_path / "a") and len(files_of(tmp_path / "a")) == 3
    assert differences(tmp_path / "a", tmp_path / "b") == []
    assert [str(difference) for difference in differences(tmp_path / "a", tmp_path / "c")] == [
        ".state/000001.json: layout differs, its values do not",
        "manifest.json: layout differs, its values do not",
    ]


def test_seconds_of_a_training_do_not_count(tmp_path: Path) -> None:
    """Whatever other numbers are like them."""
    for folder, seconds in (("a", 1.5), ("b", 2.0)):
        (tmp_path / folder).mkdir()
        document = {"training": {"seconds": seconds, "iterations": 2}, "beta": 2.0, "far": 1.5}
        (tmp_path / folder / "scene.json").write_text(json.dumps(document))
    assert differences(tmp_path / "a", tmp_path / "b") == []


def test_a_file_that_differs_is_told_once(tmp_path: Path) -> None:
    """Not by its digests in records and the manifest, too."""
    _sequence(tmp_path / "a", 1.0, "one")
    _sequence(tmp_path / "b", 2.0, "other")
    assert [difference.file for difference in differences(tmp_path / "a", tmp_path / "b")] == ["000001.npz"]


def test_intended_differences_need_a_reason(tmp_path: Path) -> None:
    file = tmp_path / "intended.json"
    file.write_text(
        json.dumps([{"case": "* busy", "file": "*.json", "part": "*.actors_skipped", "reason": "counts the present"}])
    )
    (row,) = read_intended(file)
    assert row == Intended("* busy", "*.json", "*.actors_skipped", "counts the present")
    assert row.covers("avx2 busy", "frames/manifest.json", "samples.actors_skipped")
    assert not row.covers("edited", "frames/manifest.json", "samples.actors_skipped")
    assert not row.covers("avx2 busy", "frames/manifest.json", "samples.rays")
    file.write_text(json.dumps([{"case": "*", "file": "*", "part": "*", "reason": ""}]))
    with pytest.raises(ValueError, match="none of them empty"):
        read_intended(file)


def test_cases_read_what_was_written_before() -> None:
    names = list(CASES)
    for case in CASES.values():
        for before in (*case.after, *filter(None, (case.same_as,))):
            assert names.index(before) < names.index(case.name), case.name
    quick = [case.name for case in chosen((), quick=True)]
    assert 4 < len(quick) < 12 < len(chosen((), quick=False)) == len(CASES)
    assert [case.name for case in chosen(("tiny torch",), quick=False)] == ["synth", "train tiny", "tiny torch"]
    with pytest.raises(KeyError):
        chosen(("no such",), quick=False)
