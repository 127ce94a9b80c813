"""Training from end to end on logs of a few frames: it learns, resumes to the bit, and survives being stopped."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from drive_frames import DriveFrames
from PIL import Image
from safetensors.torch import load_file, save_file
from small_log import write_small_log
from small_training import SMALL, stop_after
from whole_drive import bound_to
from written_street import write_street

from unisim_blender.core.cli.main import run
from unisim_blender.core.data.log import Log
from unisim_blender.core.errors import LogError, SceneError
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.ops.segment_trace import SegmentTrace
from unisim_blender.core.presets import PRESETS, preset
from unisim_blender.core.render.confidence import RIGHT_RGB
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracers.torch.segments import Sampling
from unisim_blender.core.render.tracers.torch.trace import trace
from unisim_blender.core.render.tracers.torch.tracer import TorchBackend
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.training.batches.data import CameraData, LidarData
from unisim_blender.core.training.checkpoint import CHECKPOINT, _settings, load_checkpoint, save_checkpoint
from unisim_blender.core.training.export import preview, preview_frame
from unisim_blender.core.training.loop import train
from unisim_blender.core.training.trainer import Trainer


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("training") / "log"
    write_small_log(out)
    return out


@pytest.fixture(scope="module")
def log(path: Path) -> Log:
    return open_log(path)


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Log:
    """Two frames of a street."""
    return open_log(write_street(tmp_path_factory.mktemp("training") / "street", 2, 48))


def files(path: Path) -> set[str]:
    return {file.name for file in path.iterdir()}


@pytest.fixture(scope="module")
def whole(log: Log, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six steps without a stop."""
    out = tmp_path_factory.mktemp("training") / "whole"
    train(log, SMALL, out, quiet=True)
    return out


@pytest.fixture(scope="module")
def trainer(log: Log) -> Trainer:
    """One whose state does not matter."""
    return Trainer(log, SMALL)


def test_a_device_without_float64_trains_and_renders_alike(
    log: Log, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As Apple's mps: times are float32 there."""
    monkeypatch.setattr("unisim_blender.core.ops.devices.has_float64", lambda device: False)
    trainer = Trainer(log, SMALL)
    kept = (trainer.model, trainer.tracklets, trainer.camera_poses)
    assert not any(b.dtype == torch.float64 for module in kept for b in module.buffers())
    train(log, SMALL, tmp_path, quiet=True)
    scene, wanted = load_scene(tmp_path), load_scene(whole)
    backend = TorchBackend(scene)
    assert bound_to(backend, scene.header.drive).tensors.own.tracklets.times.dtype == torch.float32
    got = DriveFrames(Renderer(backend), scene.header.drive).camera("front_camera", 1).rgb
    monkeypatch.undo()
    expected = DriveFrames(Renderer(TorchBackend(wanted)), wanted.header.drive).camera("front_camera", 1).rgb
    assert np.abs(got - expected).mean() < 0.01


@pytest.mark.parametrize("number", (signal.SIGINT, signal.SIGTERM))
@pytest.mark.parametrize("adversarial", (False, True))
def test_a_stopped_training_resumes_to_the_same_weights(
    log: Log, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, adversarial: bool
) -> None:
    if adversarial and number == signal.SIGTERM:
        pytest.skip("one signal is enough")
    config = replace(SMALL, adversarial=adversarial)
    reference = whole
    if adversarial:
        reference = tmp_path / "reference"
        train(log, config, reference, quiet=True)
        first, plain = (load_file(p / "weights.safetensors") for p in (reference, whole))
        assert any(not torch.equal(first[name], plain[name]) for name in plain), "the adversary has its say"
    out = tmp_path / "parts"
    with monkeypatch.context() as patch:
        stop_after(3, number, patch)
        with pytest.raises(KeyboardInterrupt):
            train(log, config, out, quiet=True)
    assert CHECKPOINT in files(out) and "scene.json" not in files(out)
    header = train(log, config, out, resume=True, quiet=True)
    assert header.training["iterations"] == 6
    assert (out / "weights.safetensors").read_bytes() == (reference / "weights.safetensors").read_bytes()
    before, after = (load_file(p / CHECKPOINT) for p in (reference, out))
    assert before.keys() == after.keys()
    for name, value in before.items():
        assert torch.equal(value, after[name]), name


def test_what_a_finished_training_leaves(log: Log, whole: Path) -> None:
    assert files(whole) >= {CHECKPOINT, "scene.json", "weights.safetensors", "training.jsonl"}
    assert not [name for name in files(whole) if name.startswith(".")]
    scene = load_scene(whole)
    training = scene.header.training
    assert training["iterations"] == 6 and training["cameras"] == ["front_camera"] and training["preset"] == "tiny"
    assert (whole / scene.header.log_path).resolve() == log.path.resolve()
    frame = DriveFrames(Renderer(TorchBackend(scene)), scene.header.drive).camera("front_camera", 1)
    assert frame.rgb.shape == (32, 48, 3) and np.isfinite(frame.rgb).all()
    frames, right = DriveFrames(Renderer(TorchBackend(scene)), scene.header.drive), []
    for number in training["frames"]:
        error = np.abs(frames.camera("front_camera", number).rgb - log.image("front_camera", number) / 255)
        right.append((error < RIGHT_RGB).all(-1).mean())
    assert training["accuracy"]["camera"] == pytest.approx(np.mean(right), abs=0.02)
    assert 0 <= training["accuracy"]["lidar"] <= 1
    assert int(scene.model.observed.sum()) > 100


def test_another_seed_gives_other_weights(log: Log, whole: Path, tmp_path: Path) -> None:
    train(log, replace(SMALL, seed=1), tmp_path / "other", quiet=True)
    assert (tmp_path / "other/weights.safetensors").read_bytes() != (whole / "weights.safetensors").read_bytes()


def test_a_finished_training_can_be_finished_again(log: Log, whole: Path, tmp_path: Path) -> None:
    """Resumed with nothing left to do, it writes the same scene."""
    out = tmp_path / "again"
    out.mkdir()
    (out / CHECKPOINT).write_bytes((whole / CHECKPOINT).read_bytes())
    train(log, SMALL, out, resume=True, quiet=True)
    assert (out / "weights.safetensors").read_bytes() == (whole / "weights.safetensors").read_bytes()


def test_a_folder_in_use_is_refused(log: Log, whole: Path, tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="holds a trained scene already"):
        train(log, SMALL, whole, quiet=True)
    with pytest.raises(SceneError, match=r"checkpoint\.safetensors: there is no checkpoint to resume"):
        train(log, SMALL, tmp_path / "new", resume=True, quiet=True)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    "change", ({"seed": 5}, {"preset": "compact"}, {"frames": (0, 1)}, {"width": 24}, {"adversarial": True})
)
def test_a_checkpoint_of_other_settings_is_refused(
    trainer: Trainer, whole: Path, monkeypatch: pytest.MonkeyPatch, change: dict[str, object]
) -> None:
    monkeypatch.setattr(trainer, "config", replace(SMALL, **change))  # type: ignore[arg-type]
    with pytest.raises(SceneError, match="is of a training with other settings"):
        load_checkpoint(whole / CHECKPOINT, trainer)


def test_a_checkpoint_of_an_earlier_version_resumes(trainer: Trainer, whole: Path, tmp_path: Path) -> None:
    """The names of earlier checkpoints are read."""
    names = {"unobserved_from": "hidden_from"}
    weights = {"sdf_band": "band", "normal_smoothness": "flat", "distortion": "spread", "unobserved": "hidden"}
    settings = json.loads(_settings(SMALL))
    settings["weights"] = {weights.get(name, name): value for name, value in settings["weights"].items()}
    settings = {names.get(name, name): value for name, value in settings.items()}
    assert "hidden_from" in settings and set(weights.values()) <= settings["weights"].keys()
    tensors = {name.replace("model.background.", "model.far."): t for name, t in load_file(whole / CHECKPOINT).items()}
    assert any(name.startswith("model.far.") for name in tensors)
    file, told = tmp_path / CHECKPOINT, {"iteration": "7", "elapsed_s": "1.5"}
    save_file(tensors, file, metadata={**told, "settings": json.dumps(settings, sort_keys=True)})
    load_checkpoint(whole / CHECKPOINT, trainer)
    expected = {name: value.clone() for name, value in trainer.model.state_dict().items()}
    with torch.no_grad():
        trainer.model.background.grid.table.zero_()
    load_checkpoint(file, trainer)
    assert trainer.iteration == 7
    assert all(torch.equal(value, expected[name]) for name, value in trainer.model.state_dict().items())
    for text in ("[]", "{", '{"weights": 3}', json.dumps({**settings, "seed": 5})):
        save_file(tensors, file, metadata={**told, "settings": text})
        with pytest.raises(SceneError, match="is of a training with other settings"):
            load_checkpoint(file, trainer)


def test_broken_checkpoints(trainer: Trainer, whole: Path, tmp_path: Path) -> None:
    file = tmp_path / CHECKPOINT
    file.write_bytes((whole / CHECKPOINT).read_bytes()[:-100])
    with pytest.raises(SceneError, match=r"checkpoint\.safetensors cannot be read"):
        load_checkpoint(file, trainer)
    save_checkpoint(file, trainer)
    tensors = load_file(file)
    del tensors["model.log_beta"]
    save_file(tensors, file, metadata={"iteration": "1", "elapsed_s": "1.0", "settings": _settings(SMALL)})
    with pytest.raises(SceneError, match="does not fit this log or version: it lacks the weights log_beta"):
        load_checkpoint(file, trainer)
    tensors["model.log_beta"] = torch.zeros(3)
    save_file(tensors, file, metadata={"iteration": "1", "elapsed_s": "1.0", "settings": _settings(SMALL)})
    with pytest.raises(SceneError, match=r"its log_beta are 3, not ") as error:
        load_checkpoint(file, trainer)
    assert "state_dict" not in str(error.value)


KILLED = """
import sys
from dataclasses import replace
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from small_training import SMALL
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.training.loop import train
config = replace(SMALL, iterations=100000, checkpoint_s=0.0)
train(open_log(Path(sys.argv[2])), config, Path(sys.argv[3]), resume=len(sys.argv) > 4, quiet=True)
"""


def test_a_kill_leaves_a_checkpoint(path: Path, trainer: Trainer, tmp_path: Path) -> None:
    out = tmp_path / "killed"
    file = out / CHECKPOINT
    command = [sys.executable, "-c", KILLED, str(Path(__file__).parents[2] / "support"), str(path), str(out)]
    iterations: list[int] = []
    for delay in (0.05, 0.21):
        seen = file.stat().st_mtime_ns if iterations else 0
        process = subprocess.Popen(
            [*command, "resume"] if iterations else command, env={**os.environ, "OMP_NUM_THREADS": "1"}
        )
        try:
            deadline = time.monotonic() + 100
            while not file.exists() or file.stat().st_mtime_ns == seen:
                assert time.monotonic() < deadline and process.poll() is None
                time.sleep(0.02)
            time.sleep(delay)
        finally:
            process.kill()
            process.wait()
        load_checkpoint(file, trainer)
        iterations.append(trainer.iteration)
    assert 1 <= iterations[0] < iterations[1]


def test_the_loss_falls_on_a_street(street: Log) -> None:
    """Over seeds 0 to 5 the last 15 steps of 120 are 0.9 to 2.2 dB better than the first, of depths 0.15 to 0.22 of the
    loss is left, of intensities 0.11 to 0.16, and of the distance to LiDAR's returns 0.18 to 0.36."""
    steps = 120
    config = replace(SMALL, frames=(0, 1), iterations=steps, patches=4, lidar_rays=256, rate_tables=(3e-2, 3e-2))
    trainer = Trainer(street, config)
    metrics = [trainer.step() for _ in range(steps)]
    names = ("psnr", "depth", "intensity", "lidar_m")
    first, last = ({name: np.mean([f[name] for f in part]) for name in names} for part in (metrics[:15], metrics[-15:]))
    assert last["psnr"] > first["psnr"] + 0.7, (first, last)
    for name, left in (("depth", 0.3), ("intensity", 0.25), ("lidar_m", 0.5)):
        assert last[name] < left * first[name], (name, first, last)


def test_what_nobody_saw_is_free_in_the_end(street: Log, tmp_path: Path) -> None:
    trainer = Trainer(street, replace(SMALL, frames=(0, 1), iterations=2))
    values = trainer.model.occupancy.values
    unknown = int(((values > 0) & (values < 254)).sum())
    beside = int((values == 254).sum())
    trainer.step()
    trainer.occupancy.free_unshown()
    assert int(((values > 0) & (values < 254)).sum()) < unknown / 100 and int((values == 254).sum()) < beside
    assert int((values == 255).sum()) > 1000


def test_previews_show_recorded_beside_rendered(
    trainer: Trainer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {name: value.clone() for name, value in trainer.model.state_dict().items()}
    preview(trainer, tmp_path / "preview.png")
    with Image.open(tmp_path / "preview.png") as image:
        assert image.size == (96, 32)
        np.testing.assert_array_equal(np.asarray(image)[:, :48], trainer.log.image(*preview_frame(trainer)))
    assert trainer.model.training and files(tmp_path) == {"preview.png"}
    for name, value in trainer.model.state_dict().items():
        assert torch.equal(value, before[name]), name
    monkeypatch.setattr(trainer, "config", replace(SMALL, frames=(0, 2, 3)))
    assert preview_frame(trainer) == ("front_camera", 1)


def test_previews_leave_the_training_as_it_is(
    log: Log, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[int] = []

    def counted(trainer: Trainer, file: Path) -> None:
        shown.append(trainer.iteration)
        preview(trainer, file)

    monkeypatch.setattr("unisim_blender.core.training.loop.preview", counted)
    monkeypatch.setattr("unisim_blender.core.training.loop.PREVIEW_SHARE", 1e-9)
    train(log, replace(SMALL, preview_s=0.0), tmp_path / "some", quiet=True)
    assert shown == [1]  # another one would cost more than its share
    monkeypatch.setattr("unisim_blender.core.training.loop.PREVIEW_SHARE", float("inf"))
    train(log, replace(SMALL, preview_s=0.0), tmp_path / "all", quiet=True)
    assert shown == [1, 1, 2, 3, 4, 5, 6] and (tmp_path / "all" / "preview.png").is_file()
    assert not (whole / "preview.png").exists()
    for name in ("some", "all"):
        assert (tmp_path / name / "weights.safetensors").read_bytes() == (whole / "weights.safetensors").read_bytes()


def test_patches_are_pixels_with_their_rays(log: Log) -> None:
    data = CameraData(log, ["front_camera"], [0, 1, 2], None, np.zeros(3))
    batch = data.patches(np.random.default_rng(0), 12, 4, 2)
    assert batch.target.shape == (12, 3, 8, 8) and len(batch.rays) == 12 * 16
    rays = {}
    for view, (_, camera, frame) in enumerate(data.views):
        image = data.images.image(view)
        u, v = pixel_grid(camera.model)
        # rays through the corners of pixels: the centres of cells of two
        whole = camera_rays(camera, camera.time_s[frame], u + 0.5, v + 0.5)
        for y in range(image.shape[0]):
            for x in range(image.shape[1]):
                rays[frame, whole.directions[y, x].astype(np.float32).tobytes()] = image, y, x
    times = {round(float(batch.rays.time_s.view(12, 16)[i, 0]), 2): i for i in range(12)}
    assert len(times) >= 3, "of several frames"
    directions = batch.rays.directions.view(12, 16, 3).numpy()
    for i in range(12):
        key = directions[i, 0].tobytes()
        image, y, x = next(rays[frame, key] for frame in range(3) if (frame, key) in rays)
        expected = image[y : y + 8, x : x + 8].transpose(2, 0, 1) / np.float32(255)
        np.testing.assert_allclose(batch.target[i].numpy(), expected, atol=1e-6)


@pytest.mark.parametrize("upsample", (1, 3))
def test_rays_are_drawn_apart_where_the_decoder_looks_at_pixels_alone(
    log: Log, monkeypatch: pytest.MonkeyPatch, trainer: Trainer, upsample: int
) -> None:
    together, _ = trainer.branches.draw_pixels(np.random.default_rng(0), 0)
    assert [(len(b.camera), b.cells) for b in together] == [(2, 8)], (
        "a patch for a decoder that sees a pixel's neighbours"
    )
    tiny = preset("tiny")
    monkeypatch.setitem(PRESETS, "alone", replace(tiny, model=replace(tiny.model, decoder_kernel=1, upsample=upsample)))
    apart = Trainer(log, replace(SMALL, preset="alone", patches=4, iterations=1))
    batches, draw = apart.branches.draw_pixels(np.random.default_rng(0), 0)
    assert [(len(b.camera), b.cells) for b in batches] == [(1, 8), (3 * 64, 1)], "as many rays as the patches had"
    assert [b.target.shape[-1] for b in batches] == [8 * upsample, upsample], "a ray's pixels"
    assert draw is not None
    for i in range(5):
        image = apart.cameras.images.image(int(draw.view[i]))
        y, x = int(draw.y[i]), int(draw.x[i])
        block = image[y : y + upsample, x : x + upsample].transpose(2, 0, 1) / np.float32(255)
        np.testing.assert_allclose(batches[1].target[i].numpy(), block, atol=1e-6)
    assert len(torch.unique(batches[1].rays.time_s)) > 20, "from all over: rows of several frames"
    assert np.isfinite(apart.step()["loss"])


def test_what_changes_slowly_is_updated_every_few_steps(log: Log) -> None:
    trainer = Trainer(log, replace(SMALL, slow_every=3, poses_from=0.0))
    slow = [p for group in trainer.slow.param_groups for p in group["params"]]
    moved = []
    for _ in range(6):
        before = [p.detach().clone() for p in slow]
        trainer.step()
        moved.append(any(not torch.equal(a, b) for a, b in zip(before, slow, strict=True)))
    assert moved == [False, False, True, False, False, True]


def test_samples_stand_still_and_are_denser_in_the_end_and_rates_fall_further(
    log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = replace(SMALL, iterations=8, still_from=0.5, still_samples=3.0)
    trainer = Trainer(log, config)
    drawn: list[tuple[bool, float]] = []
    samples: list[int] = []

    def spy(model: Any, active: Any, rays: Any, sampling: Sampling) -> SegmentTrace:
        drawn.append((sampling.jitter, sampling.fine))
        found = trace(model, active, rays, sampling)
        assert found.static is not None
        samples.append(found.static[0].t.shape[1])
        return found

    monkeypatch.setattr("unisim_blender.core.training.branches.trace", spy)
    rates = []
    first, last = config.rate_tables
    for step in range(8):
        trainer.step()
        rates.append(
            trainer.optimiser.param_groups[0]["lr"] / (first * (last / first) ** (step / 8) * (step + 1) / 100)
        )
    moments = [step <= 4 for step in range(8) for _ in ("camera", "lidar")]
    assert drawn == [(True, 1.0) if before else (False, 3.0) for before in moments]
    assert {count / samples[0] for count, before in zip(samples, moments, strict=True) if not before} == {3.0}
    assert rates == pytest.approx([1.0] * 5 + [0.1 ** (part / 4) for part in (1, 2, 3)])


def test_sweeps_give_returns_and_drops(log: Log) -> None:
    data = LidarData(log, ["pandar64"], [0, 1], np.zeros(3), log.drive.actors.values())
    batch = data.sample(np.random.default_rng(0), 400)
    assert int(batch.returned.sum()) == 340
    np.testing.assert_array_equal(batch.depth_m.numpy() > 0, batch.returned.numpy())
    share = len(data.points) / len(data.returned)
    # weighted, drops count as often as they occur
    assert float((batch.weight * batch.returned).mean()) == pytest.approx(share, abs=1e-6)
    assert float(batch.weight.mean()) == pytest.approx(1, abs=1e-6)
    origins, points = data.static_returns()
    assert origins.shape == points.shape and 0 < len(points) <= len(data.points)


def test_logs_without_what_training_needs(log: Log) -> None:
    with pytest.raises(LogError, match="no image of front_camera in the frames asked for"):
        CameraData(log, ["front_camera"], [77], None, np.zeros(3))
    with pytest.raises(LogError, match="no sweep in the frames asked for"):
        LidarData(log, ["pandar64"], [77], np.zeros(3))
    with pytest.raises(LogError, match="are 48x32, smaller than a patch of 64"):
        CameraData(log, ["front_camera"], [0], None, np.zeros(3)).patches(np.random.default_rng(0), 1, 32, 2)


def test_the_command_line(path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "scene"
    options = ["--preset", "tiny", "--iterations", "1", "--frames", "1:3", "--width", "64", "--quiet"]
    assert run(["train", str(path), "--out", str(out), *options]) == 0
    assert "1 steps" in capsys.readouterr().out
    training = json.loads((out / "scene.json").read_text())["training"]
    assert training["frames"] == [1, 2] and training["iterations"] == 1 and training["width"] == 64


@pytest.mark.parametrize(
    ("arguments", "message"),
    (
        ((), "either --minutes or --iterations"),
        (("--minutes", 1, "--iterations", 1), "either --minutes or --iterations"),
        (("--iterations", 0), "must be positive"),
        (("--minutes", "nan"), "must be positive"),
        (("--iterations", 1, "--preset", "huge"), "no preset 'huge': there are tiny, compact, small"),
        (("--iterations", 1, "--cameras", "rear"), '"rear": is not one of front_camera'),
        (("--iterations", 1, "--frames", "50:"), "selects none of the frames"),
        (("--iterations", 1, "--width", -5), "width"),
        (("--iterations", 1, "--device", "abacus"), "abacus"),
        (("--iterations", 1, "--device", "cuda"), "cuda"),
        (("--iterations", 1, "--vgg", "none.pth"), "none.pth: VGG weights cannot be read"),
        (("--iterations", 1, "--resume"), "there is no checkpoint to resume"),
    ),
)
def test_errors_of_the_command_line(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[object, ...], message: str
) -> None:
    if "cuda" in arguments and torch.cuda.is_available():
        pytest.skip("this machine has a GPU")
    code = run(["train", str(path), "--out", str(tmp_path / "scene"), "--quiet", *map(str, arguments)])
    error = capsys.readouterr().err
    assert code in (1, 2) and message in error and "Traceback" not in error, error
    assert not (tmp_path / "scene").exists() or not any((tmp_path / "scene").iterdir())
