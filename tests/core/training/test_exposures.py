"""Exposures of images, learnt with a scene, stored in its header and applied to what is rendered."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from busy_drive import backends, busy_drive
from numpy.typing import NDArray
from small_log import FRAMES, small_image, write_small_log
from small_training import SMALL

from unisim_blender.core.data.exposures import Exposures
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.sensors.rays import exposure_window
from unisim_blender.core.training.export import write_scene
from unisim_blender.core.training.losses.terms import exposed
from unisim_blender.core.training.trainer import Trainer
from unisim_blender.core.world.replay import DriveStates

GAINS = np.array([[1.0, 1, 1], [0.6, 0.7, 0.8], [1, 1, 1], [0.6, 0.7, 0.8]])


def dimmed(camera: str, frame: int) -> NDArray[np.uint8]:
    """One image, in each frame by gains of its own."""
    return np.asarray(np.clip((40 + small_image(2) * 0.5) * GAINS[frame], 0, 255), np.uint8)


def test_gains_are_learnt_and_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_small_log(tmp_path / "log")
    log = open_log(tmp_path / "log")
    monkeypatch.setattr(log, "image", dimmed)
    config = replace(
        SMALL, iterations=160, patches=4, rate_exposures=(0.03, 0.01), perceptual_from=0.1, poses_from=2.0, slow_every=2
    )
    trainer = Trainer(log, config)
    while trainer.progress < 1:
        trainer.step()
    learnt = trainer.log_gains.detach().numpy()
    assert np.abs(learnt - learnt.mean(0) - np.log(GAINS) + np.log(GAINS).mean(0)).max() < 0.15

    (tmp_path / "scene").mkdir()
    header = write_scene(trainer, tmp_path / "scene")
    camera = header.drive.cameras["front_camera"]
    at = header.exposures.at("front_camera", np.array([camera.time_s[f] for f in range(FRAMES)]))
    np.testing.assert_allclose(at, np.exp(learnt), rtol=1e-6)


@pytest.mark.parametrize("kind", ["torch", "compiled"])
def test_what_is_rendered_is_exposed_as_the_images_around_it(tmp_path: Path, kind: str) -> None:
    loaded = backends(tmp_path)
    if kind not in loaded:
        pytest.skip("the kernels are not built")
    renderer, drive = Renderer(loaded[kind]), busy_drive(tmp_path)
    # the light on a mesh is linear in another colour space
    drive = replace(drive, actors={uid: actor for uid, actor in drive.actors.items() if uid != "cube"})
    states = DriveStates(drive, loaded[kind].parked)
    camera = drive.cameras["front"]
    first, second = sorted(camera.time_s.values())[:2]
    gains = np.array([[1.0, 1, 1], [0.5, 0.7, 1.6]])

    def rendered(time_s: float, name: str = "front") -> NDArray[np.float32]:
        other = replace(camera, sensor_id=name)
        return renderer.render(states.state(*exposure_window(other, time_s)), other, time_s).rgb

    times = first, (first + second) / 2, second, second + 0.01
    plain = [rendered(time) for time in times]
    loaded[kind].exposures = Exposures({"front": (np.array([first, second]), gains)})  # type: ignore[attr-defined]
    for time, image, gain in zip(times, plain, (gains[0], gains.mean(0), gains[1], gains[1]), strict=True):
        np.testing.assert_allclose(rendered(time), np.minimum(image * gain, 1), atol=2e-6)
    assert np.array_equal(rendered(second, "another"), plain[2]), "a camera that was not recorded has no gain"
    assert not renderer.is_steady("front", first, second)
    assert renderer.is_steady("front", second, second + 1) == loaded[kind].is_steady("front", second, second + 1)


def test_saturated_pixels_are_reached_by_what_is_brighter() -> None:
    image, recorded = torch.full((1, 3, 1, 2), 0.9), torch.tensor([1.0, 0.8]).expand(1, 3, 1, 2)
    out = exposed(image, torch.full((1, 3), 0.2), recorded)
    assert float(out[0, 0, 0, 0]) == 1 and float(out[0, 0, 0, 1]) == pytest.approx(0.9 * np.exp(0.2))
