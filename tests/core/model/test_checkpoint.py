"""Trained scenes on disk: what is written comes back, and what is broken is named."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from analytic_scene import drive_of, header_of, renderer_of, still
from safetensors.torch import load_file, save_file
from torch import Tensor

from unisim_blender.core.errors import SceneError
from unisim_blender.core.model.checkpoint import TorchScene, load_scene, save_scene
from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.model.scene_file import weights_hash
from unisim_blender.core.model.volume import Volume
from unisim_blender.core.presets import preset
from unisim_blender.core.sensors.frames import CAMERA_PASSES
from unisim_blender.core.world.drive import Drive

Tensors = dict[str, Tensor]


def small_volume() -> Volume:
    return Volume(np.array([[1.0, 0, 0, -30], [0, 1, 0, -20], [0, 0, 1, -4], [0, 0, 0, 1]]), np.array([60.0, 40, 16]))


def random_scene(seed: int = 0) -> tuple[SceneModel, Drive]:
    """A model of noise that is no longer empty, and a drive of a car and a cone."""
    drive = drive_of([still("car", [-5, 1, 1], [4, 2, 2]), still("cone", [-8, -2, 0.5], [1, 1, 1])])
    torch.manual_seed(seed)
    scene = SceneModel(preset("tiny").model, small_volume(), ("car", "cone"), ("front",))
    with torch.no_grad():
        for table in (scene.static.grid.table, scene.background.grid.table):
            table.normal_(0, 0.5)
        few = torch.rand(scene.occupancy.values.shape) < 0.002
        scene.occupancy.values.copy_(torch.randint(1, 256, few.shape) * few)
        scene.get_parameter("actors.network.2.bias")[0] = -0.2
        scene.observed[3:9, 5, 2:4] = 1
        scene.ground.heights.uniform_(3.5, 4.5)
    return scene.eval().requires_grad_(False), drive


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("checkpoint") / "scene"
    scene, drive = random_scene()
    save_scene(path, header_of(scene, drive, path), scene)
    return path


def copy_of(saved: Path, out: Path) -> Path:
    out.mkdir()
    for file in saved.iterdir():
        (out / file.name).write_bytes(file.read_bytes())
    return out


def test_what_is_written_comes_back(saved: Path) -> None:
    scene, drive = random_scene()
    loaded = load_scene(saved)
    before = scene.state_dict()
    for name, value in loaded.model.state_dict().items():
        assert before[name].dtype == value.dtype and before[name].shape == value.shape, name
        if name in ("occupancy.values", "observed"):
            assert torch.equal(before[name], value), name
        else:
            # tables are stored in half precision
            torch.testing.assert_close(value, before[name], rtol=1e-3, atol=1e-6)
    with torch.no_grad():
        torch.testing.assert_close(loaded.actor_tables, scene.actors.tables(), rtol=1e-3, atol=1e-6)
    assert sorted(loaded.header.drive.actors) == sorted(drive.actors)
    assert not any(p.requires_grad for p in loaded.model.parameters()) and not loaded.model.training


def test_it_renders_the_same_bytes(saved: Path) -> None:
    model, drive = random_scene()
    with torch.no_grad():
        tables = model.actors.tables().half().float()
        for value in model.parameters():
            if value.ndim >= 2 and value.numel() > 1 << 15:
                value.copy_(value.half().float())
    scenes = TorchScene(saved, header_of(model, drive, saved), model, tables), load_scene(saved)
    frames = [renderer_of(s, s.header.drive).camera("front", 1, CAMERA_PASSES) for s in scenes]
    sweeps = [renderer_of(s, s.header.drive).lidar("top", 1) for s in scenes]
    instance = frames[0].instance
    assert instance is not None and set(instance.ravel()) == {0, 1, 2} and frames[0].rgb.std() > 0
    for name in ("rgb", "depth_m", "normal", "instance", "opacity", "unsupported"):
        assert getattr(frames[0], name).tobytes() == getattr(frames[1], name).tobytes(), name
    for name in ("depth_m", "intensity", "return_probability", "instance"):
        assert getattr(sweeps[0], name).tobytes() == getattr(sweeps[1], name).tobytes(), name


def test_equal_scenes_have_equal_files(saved: Path, tmp_path: Path) -> None:
    scene, drive = random_scene()
    save_scene(tmp_path, header_of(scene, drive, tmp_path), scene)
    assert weights_hash(saved) == weights_hash(tmp_path)
    other, _ = random_scene(seed=1)
    save_scene(tmp_path, header_of(other, drive, tmp_path), other)
    assert weights_hash(saved) != weights_hash(tmp_path)


def test_weights_beside_another_scenes_header_are_refused(saved: Path, tmp_path: Path) -> None:
    other, drive = random_scene(seed=1)
    save_scene(tmp_path, header_of(other, drive, tmp_path), other)
    load_scene(tmp_path)
    shutil.copy(saved / "weights.safetensors", tmp_path)
    with pytest.raises(SceneError, match=r"weights.safetensors does not belong to the scene.json beside it"):
        load_scene(tmp_path)


def test_nothing_half_written_stays(saved: Path) -> None:
    assert sorted(p.name for p in saved.iterdir()) == ["scene.json", "weights.safetensors"]


def test_no_hypernetwork_is_stored(saved: Path) -> None:
    names = load_file(saved / "weights.safetensors").keys()
    assert "actors.tables" in names and not any("hypernetwork" in name or "latents" in name for name in names)


def nan_in_table(t: Tensors) -> None:
    t["static.grid.table"][7, 2] = float("nan")


def infinite_beta(t: Tensors) -> None:
    t["log_beta"] = torch.tensor(float("inf"))


def nan_in_actor(t: Tensors) -> None:
    t["actors.tables"][1, 5, 3] = float("nan")


def wrong_shape(t: Tensors) -> None:
    t["ray_head.codes"] = torch.zeros(3, 4)


def missing(t: Tensors) -> None:
    del t["lidar_head.network.0.weight"]


def no_actors(t: Tensors) -> None:
    del t["actors.tables"]


def one_actor(t: Tensors) -> None:
    t["actors.tables"] = t["actors.tables"][:1].contiguous()


def no_voxels(t: Tensors) -> None:
    del t["occupancy.values.value"]


def voxel_outside(t: Tensors) -> None:
    t["observed.index"][-1] = 10**8


def voxel_before(t: Tensors) -> None:
    t["observed.index"][0] = -1


@pytest.mark.parametrize(
    ("change", "message"),
    (
        (nan_in_table, r"static\.grid\.table\[7, 2\] is not a finite number"),
        (infinite_beta, r"log_beta.* is not a finite number"),
        (nan_in_actor, r"actors\.tables\[1, 5, 3\] is not a finite number"),
        (wrong_shape, r"ray_head\.codes has shape \(3, 4\), scene\.json asks for \(1, 4\)"),
        (missing, r"lidar_head\.network\.0\.weight is missing"),
        (no_actors, r"actors\.tables is missing"),
        (one_actor, r"actors\.tables has shape \(1, \d+, 4\), scene\.json asks for \(2, \d+, 4\)"),
        (no_voxels, r"occupancy\.values is missing"),
        (voxel_outside, r"observed does not fit a grid of \(120, 80, 32\) voxels"),
        (voxel_before, r"observed does not fit a grid"),
    ),
)
def test_broken_weights(saved: Path, tmp_path: Path, change: Callable[[Tensors], None], message: str) -> None:
    path = copy_of(saved, tmp_path / "scene")
    tensors = load_file(path / "weights.safetensors")
    change(tensors)
    save_file(tensors, path / "weights.safetensors")
    with pytest.raises(SceneError, match=message) as error:
        load_scene(path)
    assert str(path / "weights.safetensors") in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("keep", (0, 5, 1000, 0.5, -1))
def test_truncated_weights(saved: Path, tmp_path: Path, keep: float) -> None:
    path = copy_of(saved, tmp_path / "scene")
    file = path / "weights.safetensors"
    whole = file.read_bytes()
    file.write_bytes(whole[: int(keep * len(whole)) if 0 < keep < 1 else int(keep)])
    with pytest.raises(SceneError, match="cannot be read") as error:
        load_scene(path)
    assert str(file) in str(error.value) and "\n" not in str(error.value)


def test_no_weights(saved: Path, tmp_path: Path) -> None:
    path = copy_of(saved, tmp_path / "scene")
    (path / "weights.safetensors").unlink()
    with pytest.raises(SceneError, match=r"weights\.safetensors: the trained scene has no weights"):
        load_scene(path)


def future(d: dict[str, Any]) -> None:
    d["version"] = 99


def other_preset(d: dict[str, Any]) -> None:
    d["model"]["static_grid"]["log2_table"] = 16


def unknown_setting(d: dict[str, Any]) -> None:
    d["model"]["colour"] = "blue"


def no_grid(d: dict[str, Any]) -> None:
    del d["model"]["background_grid"]


def both_names(d: dict[str, Any]) -> None:
    d["model"]["far_grid"] = d["model"]["background_grid"]


def word_for_number(d: dict[str, Any]) -> None:
    d["model"]["hidden"] = "wide"


def negative_levels(d: dict[str, Any]) -> None:
    d["model"]["actor_grid"]["levels"] = -2


def no_volume(d: dict[str, Any]) -> None:
    del d["volume"]["size_m"]


def flat_volume(d: dict[str, Any]) -> None:
    d["volume"]["size_m"] = [60.0, 40.0, 0.0]


def nan_volume(d: dict[str, Any]) -> None:
    d["volume"]["world_from_volume"][0][3] = "far"


@pytest.mark.parametrize(
    ("change", "message"),
    (
        (future, "version 99"),
        (other_preset, r"static\.grid\.table has shape"),
        (unknown_setting, "colour"),
        (no_grid, "background_grid"),
        (both_names, "far_grid and background_grid are both given"),
        (word_for_number, "hidden"),
        (negative_levels, "levels"),
        (no_volume, "size_m"),
        (flat_volume, "size_m"),
        (nan_volume, "world_from_volume"),
    ),
)
def test_broken_header(saved: Path, tmp_path: Path, change: Callable[[dict[str, Any]], None], message: str) -> None:
    path = copy_of(saved, tmp_path / "scene")
    document = json.loads((path / "scene.json").read_text())
    change(document)
    (path / "scene.json").write_text(json.dumps(document))
    with pytest.raises(SceneError, match=message) as error:
        load_scene(path)
    assert "\n" not in str(error.value)


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    scene, drive = random_scene()
    (tmp_path / "weights.safetensors").mkdir()
    with pytest.raises(SceneError, match=r"weights\.safetensors cannot be written"):
        save_scene(tmp_path, header_of(scene, drive, tmp_path), scene)
    assert [p.name for p in tmp_path.iterdir()] == ["weights.safetensors"]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda d: d["model"].update(hidden=1 << 20), "model.hidden is 1048576, not a whole number from 1 to 1024"),
        (lambda d: d["model"].update(voxel_m=0.002), r"model.voxel_m asks for \d+ numbers in all"),
        (
            lambda d: d["model"]["static_grid"].update(log2_table=28, features=64),
            "model.static_grid asks for .* numbers in all",
        ),
        (lambda d: d["model"]["actor_grid"].update(coarsest=0.5), "model.actor_grid has 0.5 cells along an axis"),
        (lambda d: d["training"].update(cameras=3), "training.cameras: must be an array, not 3"),
        (lambda d: d["training"].update(own_vehicle={"front": {}}), 'training.own_vehicle.front: "height" is missing'),
        (
            lambda d: d["training"].update(exposures={"front": {"time_s": [0]}}),
            'training.exposures.front: "gain" is missing',
        ),
    ],
)
def test_a_header_that_would_fill_the_memory_or_break_a_renderer_is_refused(
    saved: Path, tmp_path: Path, change: Callable[[dict[str, Any]], None], problem: str
) -> None:
    folder = copy_of(saved, tmp_path / "scene")
    document = json.loads((folder / "scene.json").read_text())
    change(document)
    (folder / "scene.json").write_text(json.dumps(document))
    with pytest.raises(SceneError, match=problem) as caught:
        load_scene(folder)
    assert str(caught.value).startswith(str(folder / "scene.json"))


def test_a_scene_by_former_names_is_the_same_scene(saved: Path, tmp_path: Path) -> None:
    """The background model's sizes and arrays were named by ``far`` once."""
    path = copy_of(saved, tmp_path / "scene")
    document = json.loads((path / "scene.json").read_text())
    model, samples = document["model"], document["model"]["samples"]
    model["far_grid"] = model.pop("background_grid")
    samples["far"], samples["far_proposals"] = samples.pop("background"), samples.pop("background_proposals")
    arrays = load_file(path / "weights.safetensors")
    former = {re.sub(r"^background\.", "far.", name): value for name, value in arrays.items()}
    assert former.keys() != arrays.keys()
    save_file(former, path / "weights.safetensors")
    document["weights"] = weights_hash(path)
    (path / "scene.json").write_text(json.dumps(document))
    found, expected = load_scene(path), load_scene(saved)
    assert found.model.config == expected.model.config
    state = found.model.state_dict()
    assert all(torch.equal(value, state[name]) for name, value in expected.model.state_dict().items())
