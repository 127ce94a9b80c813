"""Trained scenes and trainings with faults: `scene.json`, weights, checkpoints."""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from random_scene import CARS, edited
from small_log import write_small_log
from stress.scenes import make_scene

from inputs.faults import Bytes, CutOff
from inputs.profiles import COSTLY
from inputs.promise import Property, Reader
from inputs.strategies import Input, faults_of_json, inputs_of
from inputs.views import In, json_text, tensor_file
from unisim_blender.core import native
from unisim_blender.core.cli.commands.info import describe_scene, lines_of
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.model.networks import read_tensors
from unisim_blender.core.model.scene_file import HEADER_NAME, WEIGHTS_NAME, read_scene_header, read_weights
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no alarms and no bounds of memory there")


def header_reader(folder: Path) -> Reader:
    """`scene.json` alone, and what is told of it."""
    whole = {HEADER_NAME: (make_scene(folder, edited(CARS)) / HEADER_NAME).read_bytes()}

    def read() -> object:
        return lines_of(describe_scene(read_scene_header(folder / HEADER_NAME)))

    return Reader(folder, whole, read, inputs_of(whole, {HEADER_NAME: ["json"]}), (HEADER_NAME,))


def scene_reader(read: Callable[[Path], object]) -> Callable[[Path], Reader]:
    """Both files of a trained scene."""

    def make(folder: Path) -> Reader:
        made = make_scene(folder, edited(CARS))
        # without the digest, or no change of the weights would be looked at
        document = json.loads((made / HEADER_NAME).read_bytes()) | {"weights": ""}
        whole = {HEADER_NAME: json_text(document), WEIGHTS_NAME: (made / WEIGHTS_NAME).read_bytes()}
        inputs = inputs_of(whole, {HEADER_NAME: ["json"], WEIGHTS_NAME: ["tensors", "tensor names"]})
        parts = st.sampled_from(("model", "volume", "training"))
        inner = parts.flatmap(lambda part: faults_of_json({part: document[part]}))
        inputs |= inner.map(lambda faults: [In(HEADER_NAME, "json", faults)])
        return Reader(folder, whole, lambda: read(made), inputs, (HEADER_NAME, WEIGHTS_NAME, folder.name))

    return make


def weights_reader(folder: Path) -> Reader:
    """A small safetensors file, every array of it looked at."""
    arrays: dict[str, Any] = {
        "a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": np.zeros(3, np.float16), "c": np.ones((), np.int64),
        "__metadata__": {"about": "three arrays"},
    }  # fmt: skip
    whole = {WEIGHTS_NAME: tensor_file(arrays)}

    def read() -> object:
        found = read_weights(folder / WEIGHTS_NAME)
        return [found.array(name, array.shape) for name, array in found.arrays.items()]

    return Reader(folder, whole, read, inputs_of(whole, {WEIGHTS_NAME: ["tensors", "tensor names"]}), (WEIGHTS_NAME,))


def checkpoint_reader(folder: Path) -> Reader:
    """A training's checkpoint."""
    from unisim_blender.core.training.checkpoint import load_checkpoint, save_checkpoint
    from unisim_blender.core.training.config import TrainConfig
    from unisim_blender.core.training.trainer import Trainer

    write_small_log(folder / "log")
    config = TrainConfig(
        cameras=("front_camera",),
        lidars=("pandar64",),
        frames=(0, 2),
        width=None,
        preset="tiny",
        minutes=None,
        iterations=3,
    )
    trainer = Trainer(open_log(folder / "log"), config)
    trainer.step()
    file = folder / "checkpoint.safetensors"
    save_checkpoint(file, trainer)
    whole = {file.name: file.read_bytes()}
    inputs = inputs_of(whole, {file.name: ["tensors", "tensor names"]})
    return Reader(folder, whole, lambda: load_checkpoint(file, trainer), inputs, (file.name,))


def network_reader(folder: Path) -> Reader:
    """Weights of a network that users give, as safetensors and as torch's pickle."""
    state = {"net.slice1.0.weight": torch.ones(2, 3, 1, 1), "net.slice1.0.bias": torch.zeros(2)}
    buffer = io.BytesIO()
    torch.save(state, buffer)
    whole = {
        "net.safetensors": tensor_file({name: value.numpy() for name, value in state.items()}),
        "net.pth": buffer.getvalue(),
    }
    inputs = inputs_of(whole, {"net.safetensors": ["tensors", "tensor names"], "net.pth": ["torch pickle"]})
    return Reader(folder, whole, lambda: [read_tensors(folder / name, "LPIPS") for name in whole], inputs, tuple(whole))


HEADERS, WEIGHTS, CHECKPOINTS = Property(header_reader), Property(weights_reader), Property(checkpoint_reader)
TORCH, KERNELS, NETWORKS = (
    Property(scene_reader(load_scene)),
    Property(scene_reader(CompiledScene)),
    Property(network_reader),
)


@given(HEADERS.inputs)
def test_scene_headers(changes: Input) -> None:
    HEADERS.check(changes)


@given(TORCH.inputs)
def test_scenes_for_torch(changes: Input) -> None:
    TORCH.check(changes)


@pytest.mark.skipif(native.library() is None, reason="there is no native library")
@given(KERNELS.inputs)
def test_scenes_for_kernels(changes: Input) -> None:
    KERNELS.check(changes)


@given(WEIGHTS.inputs)
def test_weights(changes: Input) -> None:
    WEIGHTS.check(changes)


@COSTLY
@given(CHECKPOINTS.inputs)
def test_checkpoints(changes: Input) -> None:
    CHECKPOINTS.check(changes)


@given(NETWORKS.inputs)
@example([In("net.pth", "torch pickle", (Bytes(0, 1, b"a"),))])
@example([In("net.pth", "torch pickle", (CutOff(0),))])
def test_weights_of_networks(changes: Input) -> None:
    NETWORKS.check(changes)
