"""The cells that can stop a ray, kept: the same bits as if they were asked for, from whole and fitting files alone."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
from analytic_scene import header_of
from model.test_checkpoint import random_scene
from scipy import ndimage

from unisim_blender.core import native
from unisim_blender.core.model.checkpoint import load_scene, save_scene
from unisim_blender.core.model.scene_file import read_weights
from unisim_blender.core.render.tracers.compiled import scene as compiled_scene
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene, VoxelCells, cells_to_store
from unisim_blender.core.render.tracers.compiled.structs import address

pytestmark = pytest.mark.skipif(native.library() is None, reason="the kernels were not built")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "cells"


def saved(path: Path, baked: bool, seed: int = 0) -> Path:
    scene, drive = random_scene(seed)
    save_scene(path, header_of(scene, drive, path), scene, cells_to_store if baked else None)
    return path


def asked_again(self: Any, *_: Any) -> NoReturn:
    raise AssertionError("the trained distance is asked again")


def same(a: VoxelCells, b: VoxelCells) -> bool:
    return a.kinds.tobytes() == b.kinds.tobytes() and np.array_equal(a.boxes, b.boxes)


def test_a_finished_training_leaves_them(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = CompiledScene(saved(tmp_path / "plain", False)).cells
    kinds = (plain.kinds[:, None] >> 2 * np.arange(8)) & 3
    assert len(np.unique(kinds)) > 1 and len(np.unique(plain.boxes)) > 1, "nothing to compare"
    for file in cache.iterdir():
        file.unlink()
    baked = saved(tmp_path / "baked", True)
    monkeypatch.setattr(CompiledScene, "_evaluate_cells", asked_again)
    assert same(CompiledScene(baked).cells, plain)
    assert not list(cache.iterdir())
    load_scene(baked)


@pytest.mark.skipif(sys.platform != "linux", reason="glibc's switches")
def test_kernels_read_no_memory_that_was_given_back(tmp_path: Path, cache: Path) -> None:
    """With glibc told to unmap whatever is freed, reading it ends the process."""
    path = saved(tmp_path / "scene", True)
    scene = "unisim_blender.core.render.tracers.compiled.scene"
    script = f"from {scene} import CompiledScene; print(CompiledScene({str(path)!r}).cells.kinds.size)"
    environment = os.environ | {"MALLOC_MMAP_THRESHOLD_": "1024", "MALLOC_PERTURB_": "165"}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, (done.returncode, done.stderr[-500:])
    assert int(done.stdout) == CompiledScene(path).cells.kinds.size


def test_they_are_asked_for_once(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = saved(tmp_path / "scene", False)
    first = CompiledScene(path).cells
    assert [file.suffix for file in cache.iterdir()] == [".npz"]
    monkeypatch.setattr(CompiledScene, "_evaluate_cells", asked_again)
    assert same(CompiledScene(path).cells, first)
    # other weights, and other boxes, have others
    with pytest.raises(AssertionError, match="asked again"):
        CompiledScene(saved(tmp_path / "scene", False, seed=1))
    saved(tmp_path / "scene", False)
    assert same(CompiledScene(path).cells, first)
    text = (path / "scene.json").read_text()
    assert text.count("[4.0, 2.0, 2.0]") == 1
    (path / "scene.json").write_text(text.replace("[4.0, 2.0, 2.0]", "[4.0, 2.0, 3.0]"))
    with pytest.raises(AssertionError, match="asked again"):
        CompiledScene(path)


def test_those_of_another_header_do_not_count(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = saved(tmp_path / "scene", True)
    monkeypatch.setattr(CompiledScene, "_evaluate_cells", asked_again)
    CompiledScene(path)
    monkeypatch.setattr(compiled_scene, "CELLS_VERSION", compiled_scene.CELLS_VERSION + 1)
    with pytest.raises(AssertionError, match="asked again"):
        CompiledScene(path)


def test_a_broken_file_is_written_again(tmp_path: Path, cache: Path) -> None:
    path = saved(tmp_path / "scene", False)
    first = CompiledScene(path).cells
    (file,) = cache.iterdir()
    whole = file.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 8
    for broken in (b"", whole[: len(whole) // 2], bytes(flipped), b"no archive"):
        file.write_bytes(broken)
        assert same(CompiledScene(path).cells, first)
        assert file.read_bytes() != broken
    np.savez(file, kinds=first.kinds[1:], boxes=first.boxes)
    assert same(CompiledScene(path).cells, first)
    assert [f.name for f in cache.iterdir()] == [file.name]


def test_a_folder_that_cannot_be_written_is_done_without(tmp_path: Path, cache: Path) -> None:
    path = saved(tmp_path / "scene", False)
    cache.parent.write_text("a file where the folder would be")
    assert same(CompiledScene(path).cells, CompiledScene(path).cells)


def test_a_scene_that_cannot_be_opened_has_none(tmp_path: Path) -> None:
    scene, drive = random_scene()
    scene.get_parameter("static.grid.table").data[5] = np.nan
    save_scene(tmp_path, header_of(scene, drive, tmp_path), scene, cells_to_store)
    assert not any(name.startswith("cells.") for name in read_weights(tmp_path / "weights.safetensors").arrays)


@pytest.mark.parametrize("shape", ((1, 1, 1), (7, 1, 20), (300, 5, 4), (30, 40, 20)))
@pytest.mark.parametrize("share", (0.0, 1e-3, 0.2))
def test_clearances_are_chessboard_distances(shape: tuple[int, int, int], share: float) -> None:
    library = native.library()
    assert library is not None
    voxels = (np.random.default_rng(0).random(shape) < share).astype(np.uint8)
    out = np.empty_like(voxels)
    extent = np.array(shape, np.int32)
    library.unisim_clearance(address(voxels), address(extent), address(out))
    expected = ndimage.distance_transform_cdt(voxels == 0, "chessboard") if voxels.any() else np.full(shape, 255)
    assert np.array_equal(out, np.minimum(expected, 255))
