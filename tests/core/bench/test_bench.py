"""`unisim bench` at a tiny size: what is measured is there, finite and of the right pixels. No test asks how
fast anything is."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analytic_scene import drive_of, still
from click.testing import CliRunner
from drive_frames import DriveFrames
from numpy.typing import NDArray
from random_scene import CARS, TINY, saved

from unisim_bench import command as command_module
from unisim_bench.cases import all_cases, camera_case, loop_case, middle, state_case, subject_of, windows
from unisim_bench.measure import RendererProcess, turns
from unisim_bench.render_request import Measurement, RenderRequest, RenderSession, SceneSetup
from unisim_bench.report.metrics import depth_error, image_error, metrics_of, pareto_front
from unisim_bench.report.plots import images
from unisim_bench.report.tables import markdown, number
from unisim_bench.run import processor, run_bench
from unisim_bench.settings import DEFAULT, QUICK, TYPICAL, VARIANTS, Settings, all_methods
from unisim_bench.state_cost import STEPS, copy_places, model_actor, with_copies, with_tracks
from unisim_blender.core import native
from unisim_blender.core.errors import SceneError, UnisimError
from unisim_blender.core.geometry import FloatArray, invert_pose, transform_points
from unisim_blender.core.lenses.lens import Lens
from unisim_blender.core.lenses.mei import Mei
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole
from unisim_blender.core.model.scene_file import read_scene_header
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.quality import QUALITIES
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.scenes.recipe import load_backend
from unisim_blender.core.scenes.scene import open_scene
from unisim_blender.core.world.drive import Drive

needs_library = pytest.mark.skipif(native.library() is None, reason="the compiled kernels were not built")
SETTINGS = Settings(
    rounds=2, widths=(48,), windows=(2, 1), window=(16, 16), column_step=4, growth_width=48, growth_widths=(24, 48),
    copies=(0, 3), shares=(0.25, 1.0), memory_width=48,
    state_actors=12, state_repeats=3, state_width=48, loop_steps=2, loop_width=48,
)  # fmt: skip


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return saved(tmp_path_factory.mktemp("bench") / "scene", TINY)


@pytest.fixture(scope="module")
def measured(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of one whole measurement."""
    out = tmp_path_factory.mktemp("measured")
    said: list[str] = []
    run_bench([scene, scene], None, out, SETTINGS, said.append, quiet=True)
    assert said[-1].startswith("Written: ") and all(sentence.startswith("Left out: ") for sentence in said[:-1])
    return out


@pytest.fixture(scope="module")
def metrics(measured: Path) -> dict[str, Any]:
    document = json.loads((measured / "bench.json").read_text())
    assert document["complete"] and document["machine"]["variant"] == native.variant()
    found: dict[str, Any] = document["metrics"]
    return found


def rows_by_method(metrics: dict[str, Any], kind: str) -> dict[str, dict[str, Any]]:
    return {row["method"]: row for row in metrics[kind][0]["entries"]}


@needs_library
def test_every_method_is_measured_in_every_round(metrics: dict[str, Any]) -> None:
    assert list(metrics) == ["camera", "lidar", "pixels", "copies", "state", "region", "scenes", "loop", "memory"]
    for kind, errors in (
        ("camera", ("psnr_db", "delta_e")),
        ("lidar", ("median_mm", "p90_mm", "p99_mm", "within_2cm")),
    ):
        rows = rows_by_method(metrics, kind)
        assert {f"native {name}" for name in QUALITIES} | {"torch eager", "torch with kernels"} <= rows.keys()
        for row in rows.values():
            assert len(row["rounds_s"]) == 2 and row["seconds"] > 0 and row["per_second"] == 1 / row["seconds"]
            assert row["samples_per_ray"] > 1 and row["rays_per_second"] > 0
            assert all(math.isfinite(row[name]) for name in errors), row
            # a random scene is no easier than this, and the same scene for everyone
            assert kind == "lidar" or row["psnr_db"] > 20
        assert rows["native reference"][errors[1]] <= rows["native fast"][errors[1]]
        assert any(row["front"] for row in rows.values())
        assert set(metrics[kind][0]["truth"]) >= set(errors)


@needs_library
def test_the_same_bits_have_the_same_error(metrics: dict[str, Any]) -> None:
    rows = rows_by_method(metrics, "camera")
    if f"native {TYPICAL}, 1 thread" in rows:
        assert rows[f"native {TYPICAL}, 1 thread"]["psnr_db"] == rows[f"native {TYPICAL}"]["psnr_db"]
    assert abs(rows["torch eager"]["psnr_db"] - rows["torch with kernels"]["psnr_db"]) < 1
    for variant in VARIANTS:
        row = rows.get(f"native {TYPICAL}, {variant}")
        assert row is None or (
            row["variant"] == variant and abs(row["psnr_db"] - rows[f"native {TYPICAL}"]["psnr_db"]) < 1
        )


@needs_library
def test_growth_and_memory(metrics: dict[str, Any]) -> None:
    assert [(row["width"], row["height"]) for row in metrics["pixels"][0]["entries"]] == [(24, 16), (48, 32)]
    none, seen, behind = metrics["copies"][0]["entries"]
    assert (none["copies"], seen["copies"], behind["copies"]) == (0, 3, 3) and behind["behind"] and not seen["behind"]
    # what is out of view is left out before rays are traced, so counts do not name it
    assert behind["actors_skipped"] == none["actors_skipped"] and behind["samples_per_ray"] == none["samples_per_ray"]
    region = metrics["region"][0]
    assert region["whole_s"] > 0 and all(row["same_bits"] for row in region["entries"])
    part, whole = region["entries"]
    assert part["rays"] < 0.7 * whole["rays"]
    assert [row["sensor"] for row in metrics["scenes"][0]["entries"]] == ["camera", "lidar"] * 2
    assert all(row["weights_bytes"] > 0 and row["volume_m3"] == 60 * 40 * 16 for row in metrics["scenes"][0]["entries"])
    assert all(10 < row["peak_mb"] < 10_000 and len(row["rounds_s"]) == 1 for row in metrics["memory"][0]["entries"])


@needs_library
def test_what_a_state_costs_is_in_the_report(measured: Path, metrics: dict[str, Any]) -> None:
    """A row for a sweep and one for an image, whose steps add up."""
    (case,) = metrics["state"]
    assert case["repeats"] == 3 and [row["sensor"] for row in case["entries"]] == ["lidar", "camera"]
    for row, shape in zip(case["entries"], ((4, 180), (32, 48)), strict=True):
        assert (row["rows"], row["columns"]) == shape and row["rays"] == shape[0] * shape[1]
        assert row["actors"] == 12 and row["keys"] > 1 and 0 < row["seen"] <= 12 and 0 < row["in_reach"] <= 12
        steps = [row[f"{step}_ms"] for step in STEPS]
        assert all(0 < step < 10_000 for step in steps) and row["sum_ms"] == pytest.approx(sum(steps), rel=1e-12)
    lines = (measured / "bench.md").read_text().splitlines()
    begin = lines.index("## State of the world")
    head, rows = lines[begin + 4], lines[begin + 6 : begin + 8]
    assert all(f" {step} ms |" in head for step in (*STEPS, "sum"))
    for row, line, name in zip(case["entries"], rows, ("sweep, 4×180", "image, 48×32"), strict=True):
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        assert cells[:2] == [name, "12"] and cells[3:9] == [number(row[f"{step}_ms"]) for step in (*STEPS, "sum")]


@needs_library
def test_a_step_of_the_closed_loop_at_every_quality(scene: Path) -> None:
    """Each renders an image and a sweep; its errors are those that were measured of that quality."""
    subject, session = subject_of(scene), RenderSession()
    case = loop_case(subject, SETTINGS, 1)
    entries = case.entries[:2]
    for entry in entries:
        entry.measurements.append(session.render(entry.request))
    rows = metrics_of([replace(case, entries=entries)])["loop"][0]["entries"]
    assert [row["quality"] for row in rows] == list(QUALITIES)[:2]
    for row in rows:
        assert 0 < row["alone_s"] < 100 and 0 < row["step_s"] < 100 and row["of_alone"] > 0 and row["steps"] == 2
        assert 0 < row["world_ms"] < 10_000 and row["actors"] > 0


@needs_library
def test_a_state_costs_more_with_more_actors(scene: Path) -> None:
    """By what is bound and culled, whatever the clock says."""
    subject, session = subject_of(scene), RenderSession()
    found = []
    for actors in (1, 40):
        case = state_case(subject, replace(SETTINGS, state_actors=actors, state_repeats=1), 1)
        for entry in case.entries:
            entry.measurements.append(session.render(entry.request))
        found.append(metrics_of([case])["state"][0]["entries"])
    for few, many in zip(*found, strict=True):
        # the scene's own actors are there, however few are asked for
        assert few["actors"] == len(subject.header.drive.actors) and many["actors"] == 40
        assert few["seen"] < many["seen"] and few["in_reach"] < many["in_reach"]


def test_copies_on_tracks_are_present_and_apart() -> None:
    drive = drive_of(CARS)
    edited = with_tracks(drive, 7)
    added = [actor for uid, actor in edited.actors.items() if uid not in drive.actors]
    assert len(added) == 7 and with_tracks(drive, 0).actors == drive.actors
    first, last = drive.time_s[drive.frames[0]], drive.time_s[drive.frames[-1]]
    assert all((actor.start_s, actor.end_s) == (first, last) and actor.inserted for actor in added)
    places = np.array([actor.world_from_actor.positions[0] for actor in edited.actors.values()])
    assert len(np.unique(np.round(places, 6), axis=0)) == len(places)
    with pytest.raises(SceneError, match="no actor"):
        with_tracks(drive_of([]), 1)


@needs_library
def test_tables_and_images(measured: Path, metrics: dict[str, Any]) -> None:
    text = (measured / "bench.md").read_text()
    for title in (
        "## Camera front, frame",
        "48×32",
        "## LiDAR top",
        "## Pixels",
        "## Actors",
        "## A region",
        "## Memory",
    ):
        assert title in text
    assert "interrupted" not in text and "(scaled)" in text and processor() in text
    assert {path.name for path in measured.iterdir()} == {
        "bench.json",
        "bench.md",
        "camera.png",
        "lidar.png",
        "growth.png",
    }
    assert all(
        (measured / name).read_bytes().startswith(b"\x89PNG") for name in ("camera.png", "lidar.png", "growth.png")
    )
    assert images({}) == {} and images({"pixels": metrics["pixels"]}).keys() == {"growth.png"}


@needs_library
def test_an_interruption_leaves_what_was_measured(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, count = RendererProcess.render, 0

    def render(self: RendererProcess, request: RenderRequest) -> Measurement:
        nonlocal count
        count += 1
        if count == 5:
            raise KeyboardInterrupt
        return real(self, request)

    monkeypatch.setattr(RendererProcess, "render", render)
    with pytest.raises(KeyboardInterrupt):
        run_bench([scene], None, tmp_path / "out", SETTINGS, lambda sentence: None, quiet=True)
    document = json.loads((tmp_path / "out" / "bench.json").read_text())
    assert not document["complete"] and list(document["metrics"]) == ["camera"]
    # the truth, twice the truth, and two qualities
    assert [row["method"] for row in document["metrics"]["camera"][0]["entries"]] == ["native fast", "native balanced"]
    assert "interrupted" in (tmp_path / "out" / "bench.md").read_text()


@needs_library
def test_faults_of_a_process_come_back(scene: Path) -> None:
    with RendererProcess({}) as process:
        assert process.variant() == native.variant()
        request = RenderRequest(SceneSetup(scene / "nowhere", "front", 2), "front", QUALITIES["fast"], 48)
        with pytest.raises(SceneError, match="nowhere"):
            process.render(request)
        process._process.kill()
        with pytest.raises(UnisimError, match="has ended"):
            process.render(request)
    with RendererProcess({"UNISIM_NATIVE": "0"}) as process:
        assert process.variant() == "torch"


@needs_library
def test_a_request_renders_what_the_renderer_gives(scene: Path) -> None:
    drive = read_scene_header(scene).drive
    renderer = DriveFrames(Renderer(load_backend(open_scene(scene), quality="fine")), drive)
    region = Region(5, 3, 21, 13)
    request = RenderRequest(SceneSetup(scene, "front", 2), "front", QUALITIES["fine"], 48, (region,))
    session = RenderSession()
    session.render(replace(request, quality=QUALITIES["fast"]))
    expected = renderer.camera("front", 2, width=48)
    for whole in (True, False):
        measurement = session.render(replace(request, whole=whole))
        assert np.array_equal(measurement.pieces[0], expected.rgb[3:13, 5:21])
        assert measurement.sensor_rays == 24 * 16 and (measurement.rays == measurement.sensor_rays) == whole
    sweep = renderer.lidar("top", 2)
    for whole in (True, False):
        measurement = session.render(replace(request, sensor="top", width=0, regions=(), column_step=7, whole=whole))
        assert np.array_equal(measurement.pieces[0], sweep.depth_m[:, ::7]) and measurement.sensor_rays == 4 * 180
        assert measurement.rays == (720 if whole else 4 * 26)


class OneImage:
    """As much of a log as an image's windows are cut from."""

    path = Path("log")

    def __init__(self, drive: Drive) -> None:
        self.drive = drive
        self.pixels = np.random.default_rng(0).integers(0, 255, (32, 48, 3)).astype(np.uint8)

    def image_frames(self, camera: str) -> tuple[int, ...]:
        return (4,)

    def image(self, camera: str, frame: int) -> NDArray[np.uint8]:
        assert (camera, frame) == ("front", 4)
        return self.pixels


@needs_library
def test_recorded_images_are_compared_where_there_is_a_log(scene: Path) -> None:
    log: Any = OneImage(read_scene_header(scene).drive)
    subject = subject_of(scene, log)
    assert subject.frame == 4 and subject.setup().log == Path("log")
    case = camera_case(subject, all_methods({DEFAULT: native.variant()}, 1, torch=False)[:1], SETTINGS, 48, 1)
    regions = case.entries[0].request.regions
    assert case.recorded is not None and len(case.recorded) == len(regions) == 2
    for piece, r in zip(case.recorded, regions, strict=True):
        assert np.array_equal(piece, log.pixels[r.top : r.bottom, r.left : r.right] / np.float32(255))
    # an image that is off by a tenth everywhere
    off = [np.where(piece < 0.5, piece + np.float32(0.1), piece - np.float32(0.1)) for piece in case.recorded]
    case.entries[2].measurements.append(Measurement(1.0, 10, 10, 10, 0, 0, off))
    row = metrics_of([case])["camera"][0]["entries"][0]
    assert row["recorded_psnr_db"] == pytest.approx(20, abs=0.01) and "psnr_db" not in row


def test_pareto_front_by_hand() -> None:
    seconds, errors = [1, 2, 3, 4, 2, 5], [9, 4, 4, 1, 5, 1]
    #          beaten by          -  -  (2,4) -  (2,4) (4,1)
    assert pareto_front(seconds, errors).tolist() == [True, True, False, True, False, False]
    assert pareto_front([1, 1], [2, 2]).tolist() == [True, True]
    assert pareto_front([1, 2], [math.nan, 3]).tolist() == [False, True]
    assert pareto_front([1, 2, 3], [1.05, 1.0, 0.5], tolerance=0.1).tolist() == [True, False, True]
    assert pareto_front([], []).tolist() == []


def test_errors_of_images_and_depths() -> None:
    rng = np.random.default_rng(0)
    pieces = [rng.random((4, 5, 3), np.float32), rng.random((2, 3, 3), np.float32)]
    same = image_error(pieces, pieces)
    assert same == {"psnr_db": math.inf, "delta_e": 0}
    black, white = [np.zeros((2, 2, 3), np.float32)], [np.ones((2, 2, 3), np.float32)]
    far = image_error(black, white)
    assert far["psnr_db"] == 0 and far["delta_e"] == pytest.approx(100, abs=0.01)
    truth = np.array([10.0, 20.0, 30.0, 0.0, 5.0], np.float32)
    assert depth_error(truth, truth) == {"median_mm": 0, "p90_mm": 0, "p99_mm": 0, "within_2cm": 1, "hits_agree": 1}
    # 10 mm, 30 mm, missed, one too many, 0 mm
    found = depth_error(np.array([10.01, 20.03, 0.0, 7.0, 5.0], np.float32), truth)
    assert (
        found["median_mm"] == pytest.approx(10, abs=0.01) and found["within_2cm"] == 0.5 and found["hits_agree"] == 0.6
    )
    nothing = depth_error(np.zeros(3, np.float32), np.zeros(3, np.float32))
    assert nothing["hits_agree"] == 1 and math.isnan(nothing["median_mm"])


def test_windows_lie_in_the_image_and_apart() -> None:
    found = windows(640, 360, (3, 2), (96, 64))
    assert found[0] == Region(59, 58, 155, 122) and found[-1] == Region(485, 238, 581, 302) and len(set(found)) == 6
    assert windows(40, 30, (2, 1), (96, 64)) == (Region(0, 0, 40, 30),) * 2
    part = middle(200, 100, 0.25)
    assert part == Region(50, 25, 150, 75) and middle(200, 100, 1.0) == Region(0, 0, 200, 100)


@pytest.mark.parametrize("behind", (False, True))
def test_copies_stand_on_the_ground_in_view_or_behind(behind: bool) -> None:
    drive = drive_of(CARS)

    def ground(points: FloatArray) -> FloatArray:
        return np.asarray(points[:, 2] - 0.1 * points[:, 0])

    edited = with_copies(drive, ground, "front", 2, 60, behind)
    added = [actor for uid, actor in edited.actors.items() if uid not in drive.actors]
    assert len(added) == 60 and all(actor.inserted and actor.present(0.2) for actor in added)
    places = np.array([actor.world_from_actor.positions[0] for actor in added])
    assert np.abs(ground(places) - added[0].size_m[2] / 2).max() < 1e-9
    assert len(np.unique(np.round(places[:, :2], 6), axis=0)) == 60
    camera = drive.cameras["front"]
    local = transform_points(invert_pose(camera.world_from_camera.at(0.2)), places)
    assert ((local[:, 2] < 0) == behind).all()
    assert (np.abs(local[:, 0] / local[:, 2]) < camera.model.width / 2 / camera.model.fx).all()


@pytest.mark.parametrize("lens", [OpenCVFisheye(max_angle_deg=100), OpenCVPinhole(k1=-0.3), Mei(1.4)])
def test_copies_stand_in_view_through_a_lens(lens: Lens) -> None:
    drive = drive_of(CARS)
    front = drive.cameras["front"]
    model = replace(front.model, fx=front.model.width / 3, fy=front.model.width / 3, lens=lens)
    drive = replace(drive, cameras={"front": replace(front, model=model)})
    edited = with_copies(drive, lambda points: points[:, 2], "front", 2, 40, False)
    places = np.array([a.world_from_actor.positions[0] for uid, a in edited.actors.items() if uid not in drive.actors])
    local = transform_points(invert_pose(front.world_from_camera.at(0.2)), places)
    local[:, 1] = 0.0  # as high as the camera
    u, _, valid = model.project(local)
    assert valid.all() and (u > 0).all() and (u < model.width).all()
    # a fisheye's reach beyond what a pinhole of its focal length would see
    assert (np.abs(local[:, 0] / local[:, 2]).max() > model.width / 2 / model.fx) == isinstance(
        lens, (OpenCVFisheye, Mei)
    )


def test_a_grid_has_its_nearest_places_first() -> None:
    places = copy_places(30, 0.5)
    assert places[0].tolist() == [8, 0] and places.shape == (30, 2) and copy_places(0, 0.5).shape == (0, 2)
    assert (np.diff(places[:, 0]) >= 0).all() and (np.abs(places[:, 1]) <= 0.5 * places[:, 0]).all()


def test_the_middle_car_is_copied() -> None:
    assert model_actor(drive_of(CARS)).uid == "car"
    signs = [still("sign", (0, 0, 0), (1, 1, 1), label="Sign"), still("car", (0, 0, 0), (4, 2, 2))]
    assert model_actor(drive_of(signs)).uid == "car"
    with pytest.raises(SceneError, match="no actor"):
        model_actor(drive_of([]))


def test_methods_are_told_once() -> None:
    variants = {DEFAULT: "avx2", "portable": "portable", "avx2": "avx2", "avx512": "avx2"}
    names = [method.name for method in all_methods(variants, 2, torch=False)]
    assert names == [
        *(f"native {name}" for name in QUALITIES),
        "native balanced, 1 thread",
        "native balanced, portable",
    ]
    with_torch = all_methods(variants, 1, torch=True)
    assert not any("thread" in method.name for method in with_torch)
    assert [method.variant for method in with_torch if method.tracer == "torch"] == ["avx2", "torch"]
    assert all(method.quality.lattice == 1 and not method.whole for method in with_torch if method.tracer == "torch")


def test_turns_are_counted(scene: Path) -> None:
    subject = subject_of(scene)
    assert (subject.camera, subject.lidar, subject.frame) == ("front", "top", 3)
    cases = all_cases([subject], all_methods({DEFAULT: "avx2"}, 1, torch=False), SETTINGS)
    # truths 2 + 2; qualities 2 x 4; widths 2; copies 3; whole and parts 3; scene 2; memory 2; states 2; steps 4
    assert turns(cases, 5) == 4 + 5 * (8 + 2 + 3 + 3 + 2) + 2 + 2 + 4


def test_without_kernels_one_sentence_says_so(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNISIM_NATIVE", "0")
    with pytest.raises(UnisimError, match="make setup"):
        run_bench([scene], None, tmp_path / "out", SETTINGS, lambda sentence: None, quiet=True)
    assert not (tmp_path / "out").exists()


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Any]]:
    calls: list[Any] = []
    monkeypatch.setattr("unisim_bench.run.run_bench", lambda *arguments: calls.append(arguments))
    yield calls


def test_the_command_asks_for_what_was_said(asked: list[Any], tmp_path: Path) -> None:
    CliRunner().invoke(command_module.command, [], catch_exceptions=False)
    options = ["--quick", "--rounds", "4", "--scene", "a", "--scene", "b", "--log", "c", "--out", "d"]
    CliRunner().invoke(command_module.command, options, catch_exceptions=False)
    assert asked[0][:4] == ((command_module.SAMPLE,), None, Path("out/bench"), Settings())
    assert asked[1][:4] == ((Path("a"), Path("b")), Path("c"), Path("d"), replace(QUICK, rounds=4))


def test_numbers_have_no_exponents() -> None:
    assert [number(x) for x in (None, math.nan, math.inf, 0.0, 1234567.0, 0.000123456, 12.345)] == [
        "–", "–", "∞", "0", "1234567", "0.000123", "12.3",
    ]  # fmt: skip
    empty = {
        "processor": "p",
        "cores": 1,
        "system": "s",
        "gpu": "",
        "variant": "v",
        "python": "3",
        "packages": {},
        "commit": None,
        "load": None,
    }
    text = markdown(
        {"machine": empty, "scene": "s", "settings": {"rounds": 1}, "left_out": [], "complete": True, "metrics": {}}
    )
    assert "commit unknown" in text
