"""Detail of recorded images: what renders lack of them is found again in images from elsewhere, on walls and on actors."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from drive_frames import DriveFrames
from numpy.typing import NDArray
from rendered_folder import contents
from written_street import write_recipe

from unisim_blender.core import native
from unisim_blender.core.cli.main import unisim
from unisim_blender.core.errors import LogError
from unisim_blender.core.geometry import FloatArray, invert_pose, transform_points
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.recorded_detail import PART, RecordedDetail
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.frames import CameraFrame
from unisim_blender.core.world.drive import Camera, Drive

SAMPLE = Path(__file__).parents[3] / "sample" / "scene"
CAMERA, WIDTH, FRAME, EDGE_M = "front_camera", 240, 5, 1.5

pytestmark = pytest.mark.skipif(native.library() is None, reason="the kernels were not built")


def pattern(drive: Drive, camera: Camera, frame: CameraFrame, time_s: float) -> NDArray[np.float32]:
    """A wave of 0.05 over what an image shows: in the world over what stands, along each moving actor in its box."""
    rays = camera_rays(camera, time_s, *pixel_grid(camera.model))
    assert frame.depth_m is not None and frame.instance is not None
    points: FloatArray = (
        rays.origins + rays.directions * np.where(np.isfinite(frame.depth_m), frame.depth_m, 0)[..., None]
    )
    for number, uid in enumerate(frame.instances, 1):
        actor = drive.actors[uid]
        which = frame.instance == number
        if actor.is_moving and which.any():
            poses = actor.world_from_actor.at(rays.time_s[which])
            points[which] = np.einsum("nij,nj->ni", invert_pose(poses)[:, :3, :3], points[which] - poses[:, :3, 3])
    wave = 0.05 * np.sin(2 * np.pi / EDGE_M * points.sum(-1)).astype(np.float32)
    return np.where(np.isfinite(frame.depth_m), wave, np.float32(0))


class PatternedLog:
    """A log whose images are a scene's renders with `pattern` on them."""

    def __init__(self, backend: CompiledBackend) -> None:
        self.drive = backend.observed[0].drive
        self.path = Path("patterned")
        self._frames, self.asked = DriveFrames(Renderer(backend), self.drive), list[int]()

    def image_frames(self, name: str) -> list[int]:
        return sorted(self.drive.cameras[name].time_s)

    def image(self, name: str, frame: int) -> NDArray[np.uint8]:
        self.asked.append(frame)
        plain = self._frames.camera(name, frame, ("rgb", "depth", "instance"), WIDTH)
        camera = self._frames.sized(name, WIDTH)
        painted = plain.rgb + pattern(self.drive, camera, plain, camera.time_s[frame])[..., None]
        return np.rint(np.clip(painted, 0, 1) * 255).astype(np.uint8)


@pytest.fixture(scope="module")
def log(backend: CompiledBackend) -> PatternedLog:
    return PatternedLog(backend)


def detail_of(backend: CompiledBackend, log: Any, width: int | None = WIDTH) -> RecordedDetail:
    header = backend.observed[0]
    training = {**header.training, "width": width, "frames": [4, 6], "cameras": [CAMERA]}
    return RecordedDetail(Renderer(backend), header.drive, training, log)


def test_what_renders_lack_is_found_again_in_an_image_between(backend: CompiledBackend, log: PatternedLog) -> None:
    drive = backend.observed[0].drive
    detail = detail_of(backend, log)
    plain, whole = (DriveFrames(Renderer(backend, detail=each), drive) for each in (None, detail))
    passes = ("rgb", "depth", "instance")
    before, after = (frames.camera(CAMERA, FRAME, passes, WIDTH) for frames in (plain, whole))
    assert set(log.asked) == {4, 6}, "other frames were not learned from"
    assert before.depth_m is not None and after.depth_m is not None and before.instance is not None
    np.testing.assert_array_equal(before.depth_m, after.depth_m)
    camera = plain.sized(CAMERA, WIDTH)
    wanted = PART * pattern(drive, camera, before, camera.time_s[FRAME])
    changed = after.rgb - before.rgb
    seen = (
        (np.abs(changed).max(-1) > 0) & (before.rgb > 0.1).all(-1) & (before.rgb < 0.9).all(-1) & (before.depth_m < 40)
    )
    assert seen.mean() > 0.3 and not changed[np.isinf(before.depth_m)].any()
    moving = np.isin(before.instance, [n for n, uid in enumerate(before.instances, 1) if drive.actors[uid].is_moving])
    for some in (seen & (before.instance == 0), seen & moving):
        assert some.sum() > 100
        error = np.abs(changed[some] - wanted[some][:, None])
        assert np.median(error) < 0.01 and np.median(np.abs(wanted[some])) > 0.015
    part = whole.camera(CAMERA, FRAME, passes, WIDTH, Region(20, 60, 200, 120))
    np.testing.assert_array_equal(part.rgb, after.rgb[60:120, 20:200])


def test_recorded_images_get_their_own_detail(backend: CompiledBackend, log: PatternedLog) -> None:
    frames = DriveFrames(Renderer(backend, detail=detail_of(backend, log)), log.drive)
    plain = DriveFrames(Renderer(backend), log.drive)
    recorded = log.image(CAMERA, 4).astype(np.float32) / 255
    before, after = (np.abs(each.camera(CAMERA, 4, ("rgb",), WIDTH).rgb - recorded).mean() for each in (plain, frames))
    assert after < (1.15 - PART) * before


def test_images_larger_than_the_trainings_take_the_detail_that_was_recorded(
    backend: CompiledBackend, log: PatternedLog
) -> None:
    def rendered(trained: int | None, width: int) -> NDArray[np.float32]:
        frames = DriveFrames(Renderer(backend, detail=detail_of(backend, log, trained)), log.drive)
        return frames.camera(CAMERA, FRAME, ("rgb",), width).rgb

    np.testing.assert_array_equal(rendered(WIDTH // 2, WIDTH), rendered(None, WIDTH))
    assert (rendered(WIDTH // 2, WIDTH // 2) != rendered(None, WIDTH // 2)).any()


def test_a_log_without_the_trainings_images_is_refused(backend: CompiledBackend, log: Any) -> None:
    header = backend.observed[0]
    training = {**header.training, "frames": [997], "cameras": [CAMERA]}
    with pytest.raises(LogError, match=f"{log.path}: has none of the images"):
        RecordedDetail(Renderer(backend), header.drive, training, log)


def test_what_an_edit_removed_leaves_no_detail_behind(backend: CompiledBackend, log: PatternedLog) -> None:
    drive = log.drive
    gone = [uid for uid, actor in drive.actors.items() if not actor.is_moving]
    edited = replace(drive, actors={uid: actor for uid, actor in drive.actors.items() if uid not in gone})
    with_all = DriveFrames(Renderer(backend), drive).camera(CAMERA, FRAME, ("instance",), WIDTH)
    plain, whole = (
        DriveFrames(Renderer(backend, detail=each), edited).camera(CAMERA, FRAME, ("rgb",), WIDTH)
        for each in (None, detail_of(backend, log))
    )
    assert with_all.instance is not None
    hidden = np.isin(with_all.instance, [n for n, uid in enumerate(with_all.instances, 1) if uid in gone])
    changed = (plain.rgb != whole.rgb).any(-1)
    assert hidden.sum() > 300 and changed[hidden].mean() < 0.5 * changed[~hidden].mean()


def test_sequences_have_detail_as_asked_and_say_so(tmp_path: Path) -> None:
    log = write_recipe(tmp_path / "log", 60, frames=20, width=96, height=54, seed=0)
    scenario = tmp_path / "scenario.json"
    document = {
        "format": "unisim-scenario", "version": 1, "name": "detail", "log": str(log), "scene": str(SAMPLE), "edits": [],
        "frames": [5], "outputs": {"detail": True, "formats": ["png", "ply"], "passes": ["rgb"]},
    }  # fmt: skip
    scenario.write_text(json.dumps(document))

    def files(out: str, *more: str) -> dict[str, bytes]:
        arguments = ["render", str(scenario), "--out", str(tmp_path / out), "--width", "120", "--jobs", "1", *more]
        result = CliRunner().invoke(unisim, arguments, catch_exceptions=False)
        assert result.exit_code == 0, result.output
        return contents(tmp_path / out)

    asked, plain = files("asked"), files("plain", "--no-detail")
    assert [json.loads(each["manifest.json"])["settings"]["detail"] for each in (asked, plain)] == [True, False]
    for name in asked:
        if name.startswith(("camera", "lidar")):
            assert (asked[name] == plain[name]) == name.startswith("lidar"), name

    def refusal(*more: str) -> str:
        refused = CliRunner().invoke(unisim, ["render", str(scenario), "--out", str(tmp_path / "no"), *more])
        assert refused.exit_code != 0 and not (tmp_path / "no").exists()
        return str(refused.exception)

    assert "--detail: adds what renders of trained scenes lack" in refusal("--renderer", "surfel")
    for frame in range(0, 20, 2):
        (log / "camera" / CAMERA / f"{frame:02d}.jpg").unlink()
    assert f"{log}: has none of the images that the scene was trained on" in refusal()
    scenario.write_text(json.dumps({**document, "log": "gone"}))
    assert "gone: is not there; --detail needs the images that the scene was trained on" in refusal()


def test_a_moved_actor_takes_its_detail_along(backend: CompiledBackend, log: PatternedLog) -> None:
    drive = log.drive
    shift = np.eye(4)
    shift[2, 3] = 1.0
    uid = next(uid for uid, actor in drive.actors.items() if actor.is_moving)
    actor = drive.actors[uid]
    raised = replace(actor, world_from_actor=actor.world_from_actor.transformed(left=shift))
    edited = replace(drive, actors={**drive.actors, uid: raised})
    plain, whole = (
        DriveFrames(Renderer(backend, detail=each), edited).camera(CAMERA, FRAME, ("rgb", "instance"), WIDTH)
        for each in (None, detail_of(backend, log))
    )
    assert plain.instance is not None
    mine = plain.instance == 1 + plain.instances.index(uid)
    assert mine.sum() > 50 and (plain.rgb != whole.rgb).any(-1)[mine].mean() > 0.3
    assert transform_points(shift, np.zeros((1, 3)))[0, 2] == 1
