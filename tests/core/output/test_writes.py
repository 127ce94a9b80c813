"""What a full disk and a kill in the middle of a write leave of a trained scene, a checkpoint, a log and a film."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from analytic_scene import header_of
from model.test_checkpoint import random_scene
from PIL import Image
from small_log import small_drive

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.formats.pandaset.write import PandasetWriter, write_table
from unisim_blender.core.model.checkpoint import load_scene, save_scene
from unisim_blender.core.model.scene_file import weights_hash
from unisim_blender.core.output.video import write_video
from unisim_blender.core.training import checkpoint
from unisim_blender.core.training.config import TrainConfig

resource = pytest.importorskip("resource", reason="limits on files' sizes are POSIX's")

LIMIT_BYTES = 4096
NOISE = np.random.default_rng(0).integers(0, 256, (64, 96, 3), np.uint8)


@contextmanager
def full_disk() -> Iterator[None]:
    """No file grows beyond `LIMIT_BYTES`: the system refuses the write as it does where the disk is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT_BYTES, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def write_weights(folder: Path, seed: int = 0) -> Path:
    scene, drive = random_scene(seed)
    save_scene(folder, header_of(scene, drive, folder), scene)
    return folder / "weights.safetensors"


def write_checkpoint(folder: Path) -> Path:
    weight = torch.nn.Parameter(torch.arange(10_000.0))
    state = {"w": weight, "occupancy.values": torch.zeros(2, 2, 2), "observed": torch.zeros(2, 2, 2)}
    module: Any = SimpleNamespace(state_dict=lambda: state, named_parameters=list)
    trainer: Any = SimpleNamespace(
        iteration=1, elapsed_s=1.0, config=TrainConfig(cameras=("front",), lidars=(), frames=(0,)), model=module,
        tracklets=module, camera_poses=module, occupancy=SimpleNamespace(state=dict),
        choice=SimpleNamespace(state=dict), log_gains=torch.zeros(1, 3),
        adversary=None,
        optimiser=torch.optim.Adam([weight]), slow=torch.optim.Adam([weight]), deferred_gradients=dict,
        fingerprint=SimpleNamespace(to_json=dict),
    )  # fmt: skip
    checkpoint.save_checkpoint(folder / checkpoint.CHECKPOINT, trainer)
    return folder / checkpoint.CHECKPOINT


def write_sweep(folder: Path) -> Path:
    write_table(folder / "00.pkl.gz", {"x": np.random.default_rng(0).random(3000)})
    return folder / "00.pkl.gz"


def write_image(folder: Path) -> Path:
    drive = small_drive()
    model = drive.cameras["front_camera"].model
    PandasetWriter(folder, drive).write_image("front_camera", 0, np.resize(NOISE, (model.height, model.width, 3)))
    return folder / "camera" / "front_camera" / "00.jpg"


def write_film(folder: Path) -> Path:
    image = folder.parent / "0.png"
    if not image.exists():
        Image.fromarray(NOISE).save(image)
    write_video([image] * 10, folder / "film.mp4", 10)
    return folder / "film.mp4"


@pytest.mark.parametrize("write", [write_weights, write_checkpoint, write_sweep, write_image, write_film])
def test_a_full_disk_is_one_sentence_and_what_was_there_stays(write: Callable[[Path], Path], tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    file = write(folder)
    assert file.stat().st_size > LIMIT_BYTES, "it would have been written"
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with full_disk(), pytest.raises(UnisimError, match=rf"{file.name}.* cannot be written: ") as caught:
        write(folder)
    assert "\n" not in str(caught.value)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


KILLED = """
import os, signal, sys
from pathlib import Path
sys.path[:0] = sys.argv[1].split(os.pathsep)
from output import test_writes
import safetensors.torch
whole = safetensors.torch.save_file
def half(tensors, file):
    whole(tensors, file)
    os.truncate(file, file.stat().st_size // 2)
    os.kill(os.getpid(), signal.SIGKILL)
safetensors.torch.save_file = half
test_writes.write_weights(Path(sys.argv[2]), seed=1)
"""


def test_a_kill_in_the_middle_of_the_weights_leaves_the_scene_before(tmp_path: Path) -> None:
    folder = tmp_path / "scene"
    write_weights(folder)
    before = weights_hash(folder)
    tests = Path(__file__).parents[2]
    path = os.pathsep.join([str(tests / "support"), str(tests / "core")])
    done = subprocess.run([sys.executable, "-c", KILLED, path, str(folder)], timeout=100, check=False)
    assert done.returncode == -signal.SIGKILL
    assert len(list(folder.iterdir())) == 3, "half a file stays, under another name"
    assert weights_hash(folder) == before
    load_scene(folder)
    write_weights(folder, seed=1)
    assert weights_hash(folder) != before
    assert sorted(path.name for path in folder.iterdir()) == ["scene.json", "weights.safetensors"]


def test_a_film_is_written_without_a_fork(tmp_path: Path) -> None:
    """Between a fork and its exec gRPC's threads can close the encoder's pipes: no film came of it."""
    forks: list[int] = []
    os.register_at_fork(before=lambda: forks.append(1))
    assert write_film(tmp_path).exists() and not forks
