"""The shapes that a configuration states are those of the model that torch builds and of the file that a
scene is saved to."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analytic_scene import drive_of
from random_scene import CARS, MOVING, saved
from safetensors.numpy import load_file, save_file

from unisim_blender.core import native
from unisim_blender.core.errors import SceneError
from unisim_blender.core.geometry import make_pose, quaternion_from_yaw
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.model.config import ModelConfig
from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.model.scene_file import HEADER_NAME, WEIGHTS_NAME, read_scene_header
from unisim_blender.core.model.shapes import decoder_reach, perceptrons, stored_arrays, stored_voxels
from unisim_blender.core.model.volume import Volume
from unisim_blender.core.presets import PRESETS, preset
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene

SIZE_M = np.array([30.3, 20.0, 8.2])
TINY = preset("tiny").model
SMALLER: dict[str, Any] = {
    name: dataclasses.replace(getattr(TINY, name), levels=3)
    for name in ("static_grid", "background_grid", "actor_grid")
}
CONFIGS: dict[str, ModelConfig] = {
    # the presets' own networks behind small tables
    **{name: dataclasses.replace(one.model, **SMALLER) for name, one in PRESETS.items()},
    "own tables": dataclasses.replace(TINY, actors="tables", light="fixed"),
    "deep hypernetwork": dataclasses.replace(TINY, hyper_layers=4, hyper_hidden=5),
    "head at samples": dataclasses.replace(TINY, head="sample", decoder_blocks=3, decoder_kernel=5, upsample=3),
    "latents": dataclasses.replace(TINY, actors="latent", latent=9),
}


@pytest.mark.parametrize("cameras", (0, 3))
@pytest.mark.parametrize("name", CONFIGS)
def test_stated_shapes_are_those_of_the_model(name: str, cameras: int) -> None:
    config = CONFIGS[name]
    volume = Volume(make_pose(np.zeros(3), quaternion_from_yaw(0.3)), SIZE_M)
    model = SceneModel(config, volume, ("a", "b"), tuple(map(str, range(cameras))))
    networks = perceptrons(config)
    if config.actors == "hypernetwork":
        shapes = networks["actors.hypernetwork"].arrays("actors.hypernetwork")
        built = {
            key: tuple(value.shape)
            for key, value in model.state_dict().items()
            if key.startswith("actors.hypernetwork")
        }
        assert shapes == built
    tables = tuple(model.actors.tables().shape)
    model.actors.drop_own()
    built = {key: tuple(value.shape) for key, value in model.state_dict().items()}
    assert {**stored_arrays(config, SIZE_M, 2, cameras), **stored_voxels(config, SIZE_M)} == {
        **built,
        "actors.tables": tables,
    }
    assert decoder_reach(config) == model.camera_decoder.reach


def test_stated_arrays_are_those_of_a_saved_scene(tmp_path: Path) -> None:
    folder = saved(tmp_path / "scene", TINY)
    file = {name: array.shape for name, array in load_file(folder / WEIGHTS_NAME).items()}
    size_m = Volume.from_dict(read_scene_header(folder).volume).size_m
    stated: dict[str, Any] = dict(stored_arrays(TINY, size_m, len(drive_of([*CARS, MOVING]).actors), 1))
    voxels = [f"{name}.{part}" for name in stored_voxels(TINY, size_m) for part in ("index", "value")]
    assert {name: file.pop(name) for name in stated} == stated
    assert file.keys() - {"cells.key", "cells.kinds", "cells.boxes"} == set(voxels)


@pytest.mark.parametrize(
    "name", ["log_beta", "background.network.2.bias", "lidar_head.network.2.weight", "camera_decoder.last.weight"]
)
def test_an_array_of_another_shape_is_refused_by_all_that_open_a_scene(tmp_path: Path, name: str) -> None:
    """One sentence names the file, the array and both shapes, before anything is built."""
    folder = saved(tmp_path / "scene", TINY)
    arrays = load_file(folder / WEIGHTS_NAME)
    expected = arrays[name].shape
    arrays[name] = np.zeros((*expected, 2), np.float32)
    save_file(arrays, folder / WEIGHTS_NAME)
    whole = f"{folder / WEIGHTS_NAME}: {name} has shape {(*expected, 2)}, {HEADER_NAME} asks for {expected}"
    readers: list[Any] = [load_scene, *([CompiledScene] if native.library() is not None else [])]
    for read in readers:
        with pytest.raises(SceneError, match=re.escape(whole)):
            read(folder)
