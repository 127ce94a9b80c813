"""Times between a log's frames, from a scenario to image, sweep and labels, beside the truth of the
street at that time."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from rendered_folder import contents

from unisim_blender.core import native
from unisim_blender.core.cli.main import unisim
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.model.scene_file import read_scene_header
from unisim_blender.core.world.drive import Drive
from unisim_street.street import build_street
from unisim_street.truth import truth_camera, truth_lidar

pytestmark = pytest.mark.skipif(native.library() is None, reason="plain torch would take minutes")
SCENE = Path(__file__).parents[3] / "sample" / "scene"
CAMERA, LIDAR = "front_camera", "pandar64"
BETWEEN, NAME = 0.925, "t0000000925000us"
"""Between frames 9 and 10: at none of them, nor at a timestamp of the camera's."""
WIDTH = 160


def render(folder: Path, out: Path, *arguments: str, **members: Any) -> Any:
    document = {
        "format": "unisim-scenario",
        "version": 1,
        "name": "times",
        "log": "none",
        "scene": str(SCENE),
        "edits": [],
    }
    (folder / "scenario.json").write_text(json.dumps(document | members))
    command = ["render", str(folder / "scenario.json"), "--out", str(out), "--jobs", "1", "--width", str(WIDTH)]
    result = CliRunner().invoke(unisim, [*command, *arguments])
    if isinstance(result.exception, UnisimError):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("times")
    # 0.95 s is the camera's timestamp in frame 10
    render(folder, folder / "out", times=[BETWEEN, 0.95])
    return folder / "out"


def at(drive: Drive, time_s: float) -> Drive:
    """A drive whose frame 0 is at a time."""
    return replace(
        drive,
        cameras={CAMERA: replace(drive.cameras[CAMERA], time_s={0: time_s})},
        lidars={LIDAR: replace(drive.lidars[LIDAR], time_s={0: time_s})},
    )


def test_every_file_is_there_by_its_time(out: Path) -> None:
    names = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    for name in (NAME, "t0000000950000us"):
        wanted = {
            f"camera/{CAMERA}/{name}.png",
            f"camera/{CAMERA}/{name}.exr",
            f"labels/{name}.json",
            f".state/{name}.json",
        }
        assert wanted | {f"lidar/{LIDAR}/{name}.ply", f"lidar/{LIDAR}/{name}.npz"} <= names
    manifest = json.loads((out / "manifest.json").read_text())
    assert list(manifest["frames"]) == [NAME, "t0000000950000us"]
    assert list(json.loads((out / "timings.json").read_text())) == [NAME, "t0000000950000us"]


def test_the_image_and_the_sweep_are_those_of_the_street_at_that_time(out: Path) -> None:
    street = build_street(0, 20, 480, 270)
    image = np.asarray(Image.open(out / f"camera/{CAMERA}/{NAME}.png").convert("RGB")).astype(float)

    def psnr(time_s: float) -> float:
        truth = truth_camera(street, at(street.drive, time_s), CAMERA, 0, WIDTH).rgb
        return float(10 * np.log10(255**2 / np.mean((image - 255 * np.clip(truth, 0, 1)) ** 2)))

    here = psnr(BETWEEN)
    assert here > 24 and here > psnr(0.85) + 1 and here > psnr(1.0) + 1
    truth = truth_lidar(street, at(street.drive, BETWEEN), LIDAR, 0)
    with np.load(out / f"lidar/{LIDAR}/{NAME}.npz") as arrays:
        assert float(arrays["time_s"]) == BETWEEN and len(arrays["x"]) > 10_000
        assert arrays["time"].min() > BETWEEN - 0.1 and arrays["time"].max() < BETWEEN + 0.001
        np.testing.assert_allclose(arrays["world_from_lidar"], truth.world_from_lidar, atol=0.05)
        ranges = np.sort(np.linalg.norm(np.stack([arrays[axis] for axis in "xyz"]), axis=0))
    true = np.sort(truth.depth_m[truth.returned])
    for part in (0.25, 0.5, 0.75):
        assert abs(np.quantile(ranges, part) / np.quantile(true, part) - 1) < 0.05


def test_labels_are_of_that_time(out: Path) -> None:
    drive = read_scene_header(SCENE).drive
    labels = json.loads((out / f"labels/{NAME}.json").read_text())
    assert labels["time_us"] == 925_000 and labels["time_s"] == BETWEEN and "frame" not in labels
    assert labels["world_from_ego"]["position"] == pytest.approx(drive.world_from_ego.at(BETWEEN)[:3, 3].tolist())
    assert {box["id"] for box in labels["boxes"]} == {
        uid for uid, actor in drive.actors.items() if actor.present(BETWEEN)
    }
    assert labels["sensors"].keys() == {CAMERA, LIDAR}
    for box in labels["boxes"]:
        wanted = drive.actors[box["id"]].world_from_actor.at(BETWEEN)[:3, 3]
        assert box["world"]["position"] == pytest.approx(wanted.tolist())
        assert labels["sensors"][LIDAR]["time_s"] == BETWEEN


def test_a_time_that_is_a_frames_has_the_frames_bytes(out: Path, tmp_path: Path) -> None:
    render(tmp_path, tmp_path / "out", "--frames", "10", "--sensors", CAMERA)
    for suffix in (".png", ".exr"):
        a, b = (out / f"camera/{CAMERA}/t0000000950000us{suffix}"), (tmp_path / f"out/camera/{CAMERA}/000010{suffix}")
        assert a.read_bytes() == b.read_bytes()


def test_resuming_renders_what_is_missing_and_keeps_frames_beside(out: Path, tmp_path: Path) -> None:
    few = ("--sensors", CAMERA, "--quality", "fast")
    render(tmp_path, tmp_path / "out", "--frames", "3", *few)
    render(tmp_path, tmp_path / "out", "--times", "0.9:1:20", "--resume", *few)
    assert sorted(path.stem for path in (tmp_path / f"out/camera/{CAMERA}").glob("*.png")) == [
        "000003", "t0000000900000us", "t0000000950000us",
    ]  # fmt: skip
    before = contents(tmp_path / "out")
    said = render(tmp_path, tmp_path / "out", "--times", "0.95:1:20", "--resume", *few).output
    assert "\n0 frames rendered" in said
    (tmp_path / f"out/camera/{CAMERA}/t0000000900000us.png").unlink()
    render(tmp_path, tmp_path / "out", "--times", "0.9:1:20", "--resume", *few)
    after = contents(tmp_path / "out")
    assert {name: data for name, data in before.items() if name != "manifest.json"} == {
        name: data for name, data in after.items() if name != "manifest.json"
    }
    # an edit that no camera sees at that time leaves the capture as it is, and its labels are written again
    gone = [{"type": "remove", "actor": hidden_at(0.95)[0]}]
    render(tmp_path, tmp_path / "out", "--times", "0.95:1:20", "--resume", *few, edits=gone)
    last_run = json.loads((tmp_path / "out/manifest.json").read_text())["last_run"]
    assert last_run["rendered"] == {} and last_run["labels_alone"] == ["t0000000950000us"]


def hidden_at(time_s: float) -> list[str]:
    """Actors far behind the camera: removing one shows in labels alone."""
    drive = read_scene_header(SCENE).drive
    pose = drive.cameras[CAMERA].world_from_camera.at(time_s)
    behind = [
        uid
        for uid, a in drive.actors.items()
        if (a.world_from_actor.at(time_s)[:3, 3] - pose[:3, 3]) @ pose[:3, 2] < -15
    ]
    return sorted(uid for uid in behind if drive.actors[uid].present(time_s))


@pytest.mark.parametrize(
    ("arguments", "members", "sentence"),
    [
        (["--times", "0:1:5", "--frames", "3"], {}, "--frames 3 and --times 0:1:5: give one of the two"),
        (["--times", "0:1"], {}, '--times "0:1": must be START:STOP:RATE'),
        (["--times", "0:9:1"], {}, "times: 2 s lies outside the recording (0 … 1.9 s)"),
        ([], {"times": [1, 1]}, "times[1]: 1 s must lie after the time before"),
    ],
)
def test_what_cannot_be_is_one_sentence(
    arguments: list[str], members: dict[str, Any], sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(UnisimError) as caught:
        render(tmp_path, tmp_path / "out", *arguments, **members)
    assert sentence in str(caught.value) and not (tmp_path / "out").exists()


def test_several_rates_and_times_outside_the_recording(tmp_path: Path) -> None:
    sensors = {
        "cameras": [{"id": CAMERA, "width": 48, "times": {"start_s": 1.85, "stop_s": 2.35, "rate_hz": 6}}],
        "lidars": [{"id": LIDAR, "columns": 90, "times": {"start_s": 2.0, "stop_s": 2.5, "rate_hz": 2}}],
    }
    told = {"actors": "continue", "ego": "hold"}
    render(
        tmp_path,
        tmp_path / "out",
        "--width",
        "48",
        "--video",
        sensors=sensors,
        outside=told,
        outputs={"quality": "fast"},
    )
    stems = {kind: sorted(path.stem for path in (tmp_path / "out" / kind).rglob("*.*")) for kind in ("labels", "lidar")}
    images = sorted(path.stem for path in (tmp_path / f"out/camera/{CAMERA}").glob("*.png"))
    assert images == ["t0000001850000us", "t0000002016667us", "t0000002183333us"]
    assert set(stems["lidar"]) == {"t0000002000000us"} and stems["labels"] == sorted([*images, "t0000002000000us"])
    labels = json.loads((tmp_path / "out/labels/t0000002183333us.json").read_text())
    drive = read_scene_header(SCENE).drive
    # the vehicle stands from 0.25 s after the last frame on, at 1.9 s; actors go on
    assert labels["world_from_ego"]["position"] == pytest.approx(
        drive.world_from_ego.at(2.15)[:3, 3].tolist(), abs=1e-6
    )
    there = {box["id"]: box["world"]["position"] for box in labels["boxes"]}
    moving = next(a for a in drive.actors.values() if a.is_moving and a.end_s >= 1.9)
    assert there[moving.uid] == pytest.approx(moving.world_from_actor.at(2.183333)[:3, 3].tolist(), abs=1e-6)
    assert (tmp_path / f"out/camera/{CAMERA}.mp4").is_file()
