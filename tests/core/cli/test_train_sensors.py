"""`unisim train`: which sensors are trained on, named or not, and what it says of the others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from tiny_drive import TinyLog

from unisim_blender.core.cli.commands.train import command
from unisim_blender.core.errors import LogError, UnisimError
from unisim_blender.core.formats import readers
from unisim_blender.core.training import loop
from unisim_blender.core.training.config import TrainConfig
from unisim_blender.core.world.drive import LidarModel


class Chosen(UnisimError):
    """In place of a training: what it was asked for."""

    def __init__(self, config: TrainConfig) -> None:
        super().__init__("not trained")
        self.config = config


@pytest.fixture
def log(monkeypatch: pytest.MonkeyPatch) -> TinyLog:
    """A log of a camera "front", a LiDAR "top" and a solid-state one without a table."""
    log = TinyLog()
    top = log.drive.lidars["top"]
    solid = replace(top, sensor_id="solid", model=LidarModel(np.zeros(0), np.zeros(0), columns=1))
    log.drive = replace(log.drive, lidars={"solid": solid, "top": top})

    def sweepless(lidar: str, frame: int) -> Any:
        raise LogError(f"{lidar} has no sweep of frame {frame}")

    def asked(log: Any, config: TrainConfig, *rest: Any, **more: Any) -> Any:
        raise Chosen(config)

    monkeypatch.setattr(log, "sweep", sweepless)
    monkeypatch.setattr(readers, "open_log", lambda path: log)
    monkeypatch.setattr(loop, "train", asked)
    return log


def chosen(tmp_path: Path, *options: str) -> tuple[TrainConfig, str]:
    result = CliRunner().invoke(command, [str(tmp_path), "--out", str(tmp_path / "out"), "--iterations", "1", *options])
    assert isinstance(result.exception, Chosen), result.exception
    return result.exception.config, result.output


def test_without_names(log: TinyLog, tmp_path: Path) -> None:
    config, said = chosen(tmp_path)
    assert (config.cameras, config.lidars) == (("front",), ("top",))
    assert f"{tmp_path}: solid has no beam table, so it is left out: --lidars takes it" in said
    log.drive = replace(log.drive, lidars={"solid": log.drive.lidars["solid"]})
    config, said = chosen(tmp_path)
    assert config.lidars == ("solid",) and "so it is trained on and cannot be simulated" in said


def test_by_name(log: TinyLog, tmp_path: Path) -> None:
    config, said = chosen(tmp_path, "--lidars", "all", "--cameras", "all")
    assert (config.cameras, config.lidars) == (("front",), ("solid", "top")) and "is trained on" in said
    assert chosen(tmp_path, "--lidars", "solid")[0].lidars == ("solid",)


def test_what_is_not_there_is_one_sentence(log: TinyLog, tmp_path: Path) -> None:
    arguments = [str(tmp_path), "--out", str(tmp_path / "out"), "--iterations", "1"]
    result = CliRunner().invoke(command, [*arguments, "--lidars", "x"])
    assert str(result.exception) == '--lidars "x": is not one of solid, top'
    log.image_frames = lambda camera: ()  # type: ignore[method-assign]
    result = CliRunner().invoke(command, arguments)
    assert str(result.exception) == f"{tmp_path}: has no images to train on"
