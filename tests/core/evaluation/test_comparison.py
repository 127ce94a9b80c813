"""`unisim compare`: what is trained and kept, what stands in which column, and what happens to a run
that was cut off."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from scipy.linalg import sqrtm
from written_street import write_recipe

from unisim_blender.core import native
from unisim_blender.core.cli.main import run, unisim
from unisim_blender.core.errors import SceneError, UnisimError
from unisim_blender.core.evaluation.comparison import methods
from unisim_blender.core.evaluation.comparison.measure import cases_of
from unisim_blender.core.evaluation.comparison.methods import METHODS, USUAL, CompareOptions, Method, methods_named
from unisim_blender.core.evaluation.comparison.page import (
    Column,
    ReportTable,
    comparison_markdown,
    table_cells,
    tables_of,
)
from unisim_blender.core.evaluation.comparison.renderers import make_renderer
from unisim_blender.core.evaluation.ground_truth import CachedTruth, known_log
from unisim_blender.core.evaluation.perceptual import Inception, frechet_distance
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.model.scene_file import HEADER_NAME
from unisim_blender.core.prepare.scenario import prepare_scenario
from unisim_blender.core.training.trainer import Trainer
from unisim_street.street import RECIPE_FILE, build_street
from unisim_street.street_truth import KnownStreets
from unisim_street.usual_edits import SCENARIOS_FOLDER, write_scenarios
from unisim_street.write import write_log

TINY = Method("ours, tiny", preset="tiny")
CAMERA = "front_camera"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A street of four frames with the usual edits."""
    path = tmp_path_factory.mktemp("log") / "street"
    write_recipe(path, frames=4, width=64, height=36)
    write_scenarios(build_street(0, 4, 64, 36), path, path)
    return path


def command(log: Path, out: Path, *more: str) -> list[str]:
    """A comparison that takes seconds."""
    scenario = str(log / SCENARIOS_FOLDER / "removal.json")
    sizes = ["--iterations", "2", "--width", "64", "--truth-frames", "1", "--scenario", scenario, "--quiet"]
    return ["compare", str(log), "--out", str(out), *sizes, *more]


def make_tiny_scene(log: Path, folder: Path) -> None:
    """A scene of two steps."""
    options = CompareOptions(cameras=(CAMERA,), iterations=2, width=64)
    make_renderer("unisim", TINY, open_log(log), folder, options, quiet=True)


@pytest.mark.slow
def test_the_camera_that_looks_ahead_is_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if native.library() is None:
        pytest.skip("surfels are made by the compiled kernels")
    street = build_street(0, 4, 64, 36, ("left_camera", "front_left_camera"))
    write_log(street, tmp_path / "log", 2, progress=False)
    sizes = ["--width", "64", "--truth-frames", "1", "--quiet"]
    assert run(["compare", str(tmp_path / "log"), "--out", str(tmp_path / "out"), "--methods", "surfel", *sizes]) == 0
    assert json.loads((tmp_path / "out" / "comparison.json").read_text())["about"]["cameras"] == ["front_left_camera"]
    shutil.rmtree(tmp_path / "log" / "camera")
    assert run(["compare", str(tmp_path / "log"), "--out", str(tmp_path / "none"), "--methods", "surfel", *sizes]) == 1
    assert capsys.readouterr().err.endswith("log: has no images to compare\n")


@pytest.mark.slow
def test_the_table_grows_and_nothing_is_done_twice(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if native.library() is None:
        pytest.skip("surfels are made by the compiled kernels")
    monkeypatch.setattr(methods, "METHODS", {**METHODS, "unisim": TINY})
    out = tmp_path / "out"
    assert run(command(log, out, "--methods", "unisim")) == 0
    metrics = out / "metrics" / "unisim" / "removal.json"
    trained, before = (out / "scenes" / "unisim" / HEADER_NAME).stat(), metrics.stat()
    assert run(command(log, out, "--methods", "surfel")) == 0
    document = json.loads((out / "comparison.json").read_text())
    assert list(document["rows"]) == ["unisim", "surfel"] and document["about"]["poses"] == "log"
    assert document["rows"]["unisim"]["made"]["iterations"] == 2
    surfel = document["rows"]["surfel"]
    assert (
        surfel["replay"]["camera"]["edit"]["images"] == 2 and surfel["replay"]["lidar"]["edit"]["depth_median_m"] < 0.05
    )
    assert surfel["removal"]["camera"]["edit"]["edited"]["pixels"] > 0
    assert surfel["removal"]["camera"]["edit_costs_db"]["frame"] is not None
    assert run(command(log, out, "--methods", "unisim,surfel")) == 0
    assert metrics.stat().st_mtime_ns == before.st_mtime_ns
    assert (out / "scenes" / "unisim" / HEADER_NAME).stat().st_mtime_ns == trained.st_mtime_ns

    page = (out / "index.html").read_text()
    images = re.findall(r'src="([^"]+)"', page)
    # two frames of the replay and one of the edit, each with the truth and both methods' images and differences
    assert len(images) == 3 * 5 and all((out / name).is_file() for name in images)
    assert "| ours, tiny |" in (out / "comparison.md").read_text()

    capsys.readouterr()
    assert run(command(log, out, "--methods", "surfel", "--quality", "fast")) == 1
    error = capsys.readouterr().err
    assert "comparison.json: was measured with quality 'balanced', not 'fast'" in error and error.count("\n") == 1


def test_a_log_whose_truth_nobody_knows_is_compared_with_what_was_recorded(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(methods, "METHODS", {**METHODS, "unisim": TINY})
    real, out = tmp_path / "real", tmp_path / "out"
    shutil.copytree(log, real, ignore=shutil.ignore_patterns(RECIPE_FILE, SCENARIOS_FOLDER))
    sizes = ["--methods", "unisim", "--iterations", "2", "--width", "64", "--quiet"]
    assert run(["compare", str(real), "--out", str(out), *sizes, "--poses", "refined"]) == 0
    document = json.loads((out / "comparison.json").read_text())
    assert (
        document["about"]["street"] is None
        and document["about"]["poses"] == "refined"
        and list(document["about"]["cases"]) == ["replay"]
    )
    replay = document["rows"]["unisim"]["replay"]
    assert replay["camera"]["edit"]["images"] == 2 and replay["lidar"]["edit"]["sweeps"] == 2
    assert set(replay["psnr_db"]) == {"1", "3"} and replay["seconds"]["camera"] > 0
    assert len(list((out / "images" / "replay").iterdir())) == 2 * 3
    capsys.readouterr()
    assert run(["compare", str(real), "--out", str(out), *sizes, "--poses", "log"]) == 1
    assert "was measured with poses 'refined', not 'log'" in capsys.readouterr().err


def test_a_training_that_was_cut_off_goes_on(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded, folder = open_log(log), tmp_path / "scene"
    make_renderer(
        "unisim", TINY, recorded, folder, CompareOptions(cameras=(CAMERA,), iterations=2, width=64), quiet=True
    )
    (folder / HEADER_NAME).unlink()
    steps: list[int] = []
    plain = Trainer.step

    def counted(trainer: Trainer) -> dict[str, float]:
        steps.append(trainer.iteration)
        return plain(trainer)

    monkeypatch.setattr(Trainer, "step", counted)
    done = make_renderer(
        "unisim", TINY, recorded, folder, CompareOptions(cameras=(CAMERA,), iterations=3, width=64), quiet=True
    )
    assert done.about["iterations"] == 3 and steps == [2]
    with pytest.raises(SceneError, match=r"was trained with width 64, not 32"):
        make_renderer(
            "unisim", TINY, recorded, folder, CompareOptions(cameras=(CAMERA,), iterations=3, width=32), quiet=True
        )
    with pytest.raises(SceneError, match="with disturbed None, not .*0.3"):
        disturbed = CompareOptions(cameras=(CAMERA,), iterations=3, width=64, disturb=(0.3, 3.0))
        make_renderer("unisim", TINY, recorded, folder, disturbed, quiet=True)


def test_another_budget_density_or_loss_is_another_training(log: Path, tmp_path: Path) -> None:
    recorded, folder, options = (
        open_log(log),
        tmp_path / "scene",
        CompareOptions(cameras=(CAMERA,), iterations=2, width=64),
    )
    made = make_renderer("unisim", TINY, recorded, folder, options, quiet=True)
    assert make_renderer("unisim", TINY, recorded, folder, options, quiet=True).key == made.key
    for method, wished, problem in (
        (TINY, CompareOptions(cameras=(CAMERA,), iterations=4, width=64), "with iterations 2, not 4"),
        (TINY, CompareOptions(cameras=(CAMERA,), minutes=5.0, width=64), "with minutes None, not 5.0"),
        (replace(TINY, density="unisim"), options, "with density logistic, not unisim"),
        (replace(TINY, adversarial=True), options, "with adversarial False, not True"),
    ):
        with pytest.raises(SceneError, match=problem):
            make_renderer("unisim", method, recorded, folder, wished, quiet=True)


def test_the_truth_is_kept_and_a_broken_file_is_made_again(log: Path, tmp_path: Path) -> None:
    scenario = log / SCENARIOS_FOLDER / "removal.json"
    true = KnownStreets.open(log).truth(prepare_scenario(scenario, refined=False), (0, 2), (CAMERA,), 64)
    cached = CachedTruth(true, tmp_path)
    first = cached.images(CAMERA, 1)
    (file,) = tmp_path.iterdir()
    again = cached.images(CAMERA, 1)
    assert first.replay is not None and again.replay is not None
    assert np.array_equal(first.edit, again.edit) and np.array_equal(first.replay, again.replay)
    assert np.array_equal(first.regions.edited, again.regions.edited) and first.regions.edited.any()
    file.write_bytes(file.read_bytes()[:100])
    assert np.array_equal(cached.images(CAMERA, 1).edit, first.edit)


def test_cases_are_held_out_frames_and_edits(log: Path, tmp_path: Path) -> None:
    recorded, street = open_log(log), known_log(log)
    cases = {
        case.name: case
        for case in cases_of(recorded, street, tmp_path, CompareOptions(cameras=(CAMERA,), truth_frames=1))
    }
    assert cases["replay"].frames == (1, 3) and cases["replay"].scenario == log
    assert {"removal", "insertion", "cones", "retiming"} == {
        n for n, p in cases.items() if n != "replay" and not p.moves_view
    }
    assert {"shift-0.5m", "shift-2m", "shift-3m"} == {n for n, p in cases.items() if p.moves_view}
    assert all(len(p.frames) == 1 and p.frames[0] in (1, 3) for n, p in cases.items() if n != "replay")
    with pytest.raises(UnisimError, match="leaves no frame to compare"):
        cases_of(recorded, street, tmp_path, CompareOptions(cameras=(CAMERA,), frames=":"))
    with pytest.raises(UnisimError, match="has no known ground truth"):
        cases_of(
            recorded,
            None,
            tmp_path,
            CompareOptions(cameras=(CAMERA,), scenarios=(log / SCENARIOS_FOLDER / "removal.json",)),
        )
    (case,) = cases_of(recorded, None, tmp_path, CompareOptions(cameras=(CAMERA,)))
    assert case.name == "replay"


def test_methods_by_name() -> None:
    assert tuple(methods_named(None)) == USUAL and tuple(methods_named(("all",))) == tuple(METHODS)
    assert tuple(methods_named(("warp", "unisim"))) == ("unisim", "warp"), "the table's order"
    with pytest.raises(UnisimError, match="no method 'gaussians': there are unisim, "):
        methods_named(("gaussians",))


def test_columns_and_their_best() -> None:
    table = ReportTable(
        "T", (Column("up", ("a",), "{:.1f}"), Column("down", ("b", "c"), "{:.0f}", 100, min), Column("none", ("d",)))
    )
    rows: dict[str, dict[str, Any]] = {
        "x": {"title": "X", "a": 1.04, "b": {"c": 0.5}},
        "y": {"title": "Y", "a": 1.02, "b": {"c": 0.25}},
        "z": {"title": "Z", "a": None},
    }
    headings, cells = table_cells(table, rows)
    assert headings == ["up", "down"], "a column in which no row has a figure is left out"
    # equal as printed is equal
    assert [(c.text, c.best) for c in cells["x"]] == [("1.0", True), ("50", False)]
    assert [(c.text, c.best) for c in cells["y"]] == [("1.0", True), ("25", True)]
    assert [(c.text, c.best) for c in cells["z"]] == [("", False), ("", False)]
    assert "| Y | **1.0** | **25** |" in comparison_markdown("M", "about", [table], rows)
    titles = [t.title for t in tables_of({"replay": False, "removal": False, "shift-2m": True})]
    assert len(titles) == 5 and titles[1].startswith("removal") and titles[2].startswith("shift-2m")


def test_frechet_distance_of_hand_worked_sets() -> None:
    # means 1 and 4, variances 2 and 2: 9 + 4 - 2 sqrt(4)
    assert frechet_distance(np.array([[0.0], [2.0]]), np.array([[3.0], [5.0]])) == pytest.approx(9)
    # variances 2 and 8: 10 - 2 sqrt(16)
    assert frechet_distance(np.array([[-1.0], [1.0]]), np.array([[-2.0], [2.0]])) == pytest.approx(2)
    assert np.isnan(frechet_distance(np.zeros((1, 3)), np.zeros((5, 3))))
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(40, 6)), 0.5 + rng.normal(size=(30, 6)) @ rng.normal(size=(6, 6))
    ca, cb = np.cov(a.T), np.cov(b.T)
    plain = ((a.mean(0) - b.mean(0)) ** 2).sum() + np.trace(ca + cb - 2 * sqrtm(ca @ cb).real)
    assert frechet_distance(a, b) == pytest.approx(plain, rel=1e-9)
    # fewer members than features
    assert frechet_distance(a[:4], a[:4]) == pytest.approx(0, abs=1e-9)


class _Means(torch.nn.Module):
    def forward(self, x: torch.Tensor, return_features: bool = False) -> torch.Tensor:
        return x.float().mean((2, 3))


def test_inception_is_a_file_of_the_users(tmp_path: Path) -> None:
    torch.jit.script(_Means()).save(tmp_path / "means.pt")
    image = np.stack([np.full((4, 5), v, np.uint8) for v in (10, 20, 30)], -1)
    assert Inception(tmp_path / "means.pt").features(image).tolist() == [10, 20, 30]
    (tmp_path / "junk.pt").write_bytes(b"no network")
    with pytest.raises(UnisimError, match="junk.pt: is no TorchScript"):
        Inception(tmp_path / "junk.pt")


def test_eval_takes_a_scene_for_scenarios_that_name_none(log: Path, tmp_path: Path) -> None:
    scenario = str(log / SCENARIOS_FOLDER / "removal.json")
    make_tiny_scene(log, tmp_path / "scene")
    asked = ["eval", "--truth", str(log), scenario, "--frames", "1", "--out", str(tmp_path / "out")]
    found = CliRunner().invoke(unisim, asked)
    assert isinstance(found.exception, UnisimError) and "give one with --scene" in str(found.exception)
    found = CliRunner().invoke(unisim, [*asked, "--scene", str(tmp_path / "scene")], catch_exceptions=False)
    assert found.exit_code == 0 and "camera.edit.psnr_db" in found.output


def test_a_log_is_rendered_with_a_scene_that_nothing_names(log: Path, tmp_path: Path) -> None:
    make_tiny_scene(log, tmp_path / "scene")
    out = tmp_path / "out"
    asked = [
        "render",
        str(log),
        "--scene",
        str(tmp_path / "scene"),
        "--frames",
        "1",
        "--sensors",
        CAMERA,
        "--out",
        str(out),
    ]
    assert run([*asked, "--width", "32", "--jobs", "1"]) == 0
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["settings"]["renderer"] == "neural"
