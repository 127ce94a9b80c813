"""What `tools/compare_bytes.py` calls a difference, and what not."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from PIL import Image
from plyfile import PlyData, PlyElement
from safetensors.torch import save_file

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT / "tools"))

from byte_checks.cases import CASES, chosen  # noqa: E402
from byte_checks.difference import Intended, differences, files_of, read_intended  # noqa: E402
from byte_checks.trees import Tree, TreeError, git, in_force  # noqa: E402
from compare_bytes import Comparison  # noqa: E402

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


def _image(
    path: Path, instance: list[int], instances: list[str], time_s: float = 0.5, dtype: type[np.generic] = np.float32
) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "unisim": json.dumps({"time_s": time_s, "instances": instances})}
    OpenEXR.File(header, {"instance": np.array([instance], dtype)}).write(str(path))


def _sweep(path: Path, instance: list[int], instances: list[str]) -> None:
    np.savez(path, instance=np.array(instance), instances=np.array(instances, np.str_))


@pytest.mark.parametrize(
    "name, write",
    [("frame.exr", _image), ("frame.exr", partial(_image, dtype=np.uint32)), ("frame.npz", _sweep)],
    ids=["image", "image of whole numbers", "sweep"],
)
def test_instances_are_compared_by_name_too(tmp_path: Path, name: str, write: Callable[..., None]) -> None:
    """Numbers that are others because a list is shorter are told apart from another actor that is there."""
    shown = {
        "a": ([0, 2, 3], ["bus", "car", "van"]),
        "b": ([0, 1, 2], ["car", "van"]),
        "c": ([0, 2, 1], ["car", "van"]),
    }
    for folder, arrays in shown.items():
        (tmp_path / folder).mkdir()
        write(tmp_path / folder / name, *arrays)
    (renumbered,) = differences(tmp_path / "a", tmp_path / "b")
    assert {part.name for part in renumbered.parts} == {"instance", "instances"}
    (swapped,) = differences(tmp_path / "b", tmp_path / "c")
    assert {part.name for part in swapped.parts} == {"instance", "instance by name"}


def test_an_images_header_is_compared_by_its_members(tmp_path: Path) -> None:
    for folder, time_s in (("a", 0.5), ("b", 0.75)):
        (tmp_path / folder).mkdir()
        _image(tmp_path / folder / "frame.exr", [0, 1], ["car"], time_s)
    (found,) = differences(tmp_path / "a", tmp_path / "b")
    assert [part.name for part in found.parts] == ["header time_s"] and "0.75" in found.parts[0].how


@pytest.mark.parametrize("renderer, counts", [("surfel", False), ("warp", False), ("neural", True)])
def test_what_surfels_are_kept_under_does_not_count(tmp_path: Path, renderer: str, counts: bool) -> None:
    """It has the code in it; of a trained scene the same place has the digest of its weights."""
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        manifest = {"inputs": {"scenes": {"own": f"of {folder}"}}, "settings": {"renderer": renderer}}
        (tmp_path / folder / "manifest.json").write_text(json.dumps(manifest))
    found = [part.name for difference in differences(tmp_path / "a", tmp_path / "b") for part in difference.parts]
    assert found == (["inputs.scenes.own"] if counts else [])


PATTERN = {"case": "* busy", "file": "*.json", "part": "*.actors_skipped"}


def test_intended_differences_have_a_commit_and_a_reason(tmp_path: Path) -> None:
    file = tmp_path / "intended.json"
    file.write_text(json.dumps([{"commit": "abc1234", "reason": "counts the present", "differences": [PATTERN]}]))
    (row,) = read_intended(file)
    assert row == Intended("abc1234", "counts the present", "* busy", "*.json", "*.actors_skipped")
    assert row.covers("avx2 busy", "frames/manifest.json", "samples.actors_skipped")
    assert not row.covers("edited", "frames/manifest.json", "samples.actors_skipped")
    assert not row.covers("avx2 busy", "frames/manifest.json", "samples.rays")


@pytest.mark.parametrize(
    "row",
    [
        {"commit": "abc1234", "reason": "", "differences": [PATTERN]},
        {"commit": "abc1234", "reason": "meant", "differences": []},
        {"reason": "meant", "differences": [PATTERN]},
        {"commit": "abc1234", "reason": "meant", "differences": [{**PATTERN, "part": ""}]},
        {"commit": "abc1234", "reason": "meant", "differences": [{**PATTERN, "more": "x"}]},
        {"commit": "abc1234", "reason": "meant", "differences": ["*"]},
    ],
)
def test_an_intended_difference_that_lacks_something_is_refused(tmp_path: Path, row: object) -> None:
    file = tmp_path / "intended.json"
    file.write_text(json.dumps([row]))
    with pytest.raises(ValueError, match="none of them empty"):
        read_intended(file)


@pytest.fixture
def history(tmp_path: Path) -> tuple[Path, list[str]]:
    """A repository of three commits, the second of which changed bytes on purpose; and its commits."""
    name = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    git(tmp_path, "init", "--quiet")
    commits = []
    for words in ("first", "light", "last"):
        git(tmp_path, *name, "commit", "--quiet", "--allow-empty", "-m", words)
        commits.append(git(tmp_path, "rev-parse", "HEAD"))
    return tmp_path, commits


def test_an_intended_difference_holds_for_bases_before_its_commit(history: tuple[Path, list[str]]) -> None:
    root, (first, light, last) = history
    rows = [Intended(light, "light", "*", "*.exr", "R")]
    assert in_force(rows, root, first) == rows
    assert in_force(rows, root, light) == in_force(rows, root, last) == []


def test_an_intended_difference_of_no_commit_before_is_refused(history: tuple[Path, list[str]]) -> None:
    root, (first, light, last) = history
    git(root, "checkout", "--quiet", first)
    for commit in (light, "0" * 40, "none"):
        with pytest.raises(TreeError, match=commit):
            in_force([Intended(commit, "later", "*", "*", "*")], root, first)


def test_the_list_of_intended_differences_is_whole() -> None:
    """Each commit once, and what each pattern names is a case."""
    file = ROOT / "tools" / "intended_differences.json"
    commits = [row["commit"] for row in json.loads(file.read_text())]
    assert len(commits) == len(set(commits))
    for row in read_intended(file):
        assert any(fnmatchcase(case, row.case) for case in CASES), row


def _judged(folder: Path, intended: list[Intended], name: str = "drawn returns") -> Comparison:
    """A comparison of what was written into ``folder`` before, of one case."""
    base, head = (Tree(tree, ROOT, folder / tree) for tree in ("base", "head"))
    comparison = Comparison(base, head, folder / "inputs", folder / "made", intended, again=True)
    comparison.run(CASES[name])
    return comparison


def test_what_was_written_is_judged_again(tmp_path: Path) -> None:
    for tree, value in (("base", 4.0), ("head", 4.5)):
        (tmp_path / tree / "drawn returns").mkdir(parents=True)
        _npz(tmp_path / tree / "drawn returns" / "000005.npz", value)
    assert _judged(tmp_path, []).failed == ["drawn returns"]
    row = Intended("abc1234", "deeper", "drawn *", "*.npz", "depth")
    meant = _judged(tmp_path, [row])
    assert meant.failed == [] and meant.identical == 0 and meant.used == {row: 1}
    assert meant.summary() == ["", "abc1234: deeper", "0 identical, 1 as intended, 0 failed, 0 not run"]
    assert _judged(tmp_path, [Intended("abc1234", "others", "drawn *", "*.npz", "ring")]).failed == ["drawn returns"]


def test_a_case_that_left_nothing_is_no_success(tmp_path: Path) -> None:
    assert _judged(tmp_path, []).failed == ["drawn returns"]


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
