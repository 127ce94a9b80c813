"""Files that are kept to save work, with faults: such a file counts as missing, or what it holds fits together."""

from __future__ import annotations

import io
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from random_scene import CARS, edited
from small_log import write_small_log
from stress.scenes import make_scene

from inputs.faults import Array, Bytes, Copy, Drop, Entry, Put, Shape
from inputs.promise import Property, Reader
from inputs.strategies import Input, gone, inputs_of
from inputs.views import In, json_text
from unisim_blender.core import native
from unisim_blender.core.actor_images.cache import cached_images, image_folder, make_images
from unisim_blender.core.evaluation.comparison.page import comparison_markdown, tables_of
from unisim_blender.core.evaluation.comparison.run import _earlier
from unisim_blender.core.evaluation.ground_truth import REGION_MASKS, _cached
from unisim_blender.core.files import CACHE_VARIABLE
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.model.scene_file import HEADER_NAME, read_scene_header
from unisim_blender.core.render.observed_space import (
    AZIMUTH_CELLS,
    ELEVATION_CELLS,
    ObservedSpace,
    _Observing,
    cache_space,
    cached_space,
)
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.surfels.cache import _cached as kept_surfels
from unisim_blender.core.render.tracers.surfels.cache import surfels_of
from unisim_blender.core.render.tracers.surfels.model import LIDARSIM

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no alarms and no bounds of memory there")


@contextmanager
def cache_in(folder: Path) -> Iterator[None]:
    """Keep files below a folder."""
    before = os.environ.get(CACHE_VARIABLE)
    os.environ[CACHE_VARIABLE] = str(folder)
    try:
        yield
    finally:
        os.environ.pop(CACHE_VARIABLE) if before is None else os.environ.update({CACHE_VARIABLE: before})


def contents(folder: Path, below: Path) -> dict[str, bytes]:
    """Return the files below a folder by their names from ``folder``."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in below.rglob("*") if path.is_file()}


def image_reader(folder: Path) -> Reader:
    """Thumbnails of a log's actors, and the index of them."""
    log = folder / "log"
    write_small_log(log)
    with cache_in(folder / "cache"):
        list(make_images(open_log(log)))
        kept = image_folder(log)
    whole = contents(folder, folder / "cache")
    index = (kept / "actors.json").relative_to(folder).as_posix()

    def read() -> object:
        with cache_in(folder / "cache"):
            found = cached_images(log)
        for uid, one in (found or {}).items():
            assert type(uid) is type(one.word) is str and (one.image is None or one.image.parent == kept)
        return found

    inputs = inputs_of({index: whole[index]}, {index: ["json"]})
    return Reader(folder, whole, read, inputs | inputs | gone(whole), (), refuses=False)


def surfel_reader(folder: Path) -> Reader:
    """A log's surfels, and rays through them."""
    log = folder / "log"
    write_small_log(log)
    with cache_in(folder):
        list(surfels_of(open_log(log), LIDARSIM))
    (made,) = (folder / "surfels").iterdir()
    # under a name that does not change with the code
    whole = {f"surfels/{path.name}": path.read_bytes() for path in made.iterdir()}
    shutil.rmtree(made)
    kept = folder / "surfels"
    views = {name: ["json"] if name.endswith(".json") else ["npy"] for name in whole}
    origins, directions = np.zeros((4, 3)), np.eye(4, 3) + [[0.5, 0.1, 0.1]] * 4
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    def read() -> object:
        scene = kept_surfels(kept)
        for faces in () if scene is None else (scene.static, *scene.actors.values()):
            hits = faces.triangles.first_hits(origins, directions, 0.1)
            assert (hits.face < len(faces)).all()
        if scene is not None:
            scene.ground.at(origins)
            scene.drops.probability(np.ones(4), np.ones(4), np.ones(4))
            scene.exposures.at("front_camera", np.arange(4.0))
        return scene

    return Reader(folder, whole, read, inputs_of(whole, views) | gone(whole), (), refuses=False)


def cell_reader(folder: Path) -> Reader:
    """Cells that can stop a ray, of a scene that does not hold them."""
    scene = make_scene(folder / "scene", edited(CARS))
    with cache_in(folder):
        expected = CompiledScene(scene).cells
    whole = contents(folder, folder)
    (cells,) = (name for name in whole if name.startswith("cells/"))

    def read() -> object:
        with cache_in(folder):
            found = CompiledScene(scene).cells
        assert found.kinds.shape == expected.kinds.shape and found.boxes.shape == expected.boxes.shape
        assert found.kinds.dtype == np.uint16 and found.boxes.dtype == np.uint8
        return found

    inputs = inputs_of({cells: whole[cells]}, {cells: ["npz"]})
    return Reader(folder, whole, read, inputs | gone({cells: b""}), (), keeps=False, refuses=False)


def space_reader(folder: Path) -> Reader:
    """What a scene's recording observed."""
    header = read_scene_header(make_scene(folder / "scene", edited(CARS)) / HEADER_NAME)
    rng = np.random.default_rng(0)
    shown = rng.integers(0, 2, (5, 6, 7), np.uint8)
    empty = _Observing(header, (1, 1, 1), 0.5)
    background = rng.random((ELEVATION_CELLS, AZIMUTH_CELLS)) < 0.5
    space = ObservedSpace(
        empty.volume_from_world, empty.size_m, 0.5, shown > 0, rng.random(shown.shape) < 0.5, background
    )
    with cache_in(folder):
        cache_space(header, space)
    whole = contents(folder, folder / "observed")
    (name,) = whole

    def read() -> object:
        with cache_in(folder):
            found = cached_space(header, shown, 0.5)
        assert found is None or (
            found.passed.shape == shown.shape and found.background.shape == (ELEVATION_CELLS, AZIMUTH_CELLS)
        )
        return found

    return Reader(folder, whole, read, inputs_of(whole, {name: ["npz"]}) | gone(whole), (), refuses=False)


def truth_reader(folder: Path) -> Reader:
    """True images of an edit."""
    rng = np.random.default_rng(0)
    true: dict[str, Any] = {name: rng.random((4, 6)) < 0.5 for name in REGION_MASKS}
    true |= {name: rng.integers(0, 256, (4, 6, 3), np.uint8) for name in ("edit", "replay")}
    file = io.BytesIO()
    np.savez_compressed(file, **true)
    whole = {"truth.npz": file.getvalue()}

    def read() -> object:
        found = _cached(folder / "truth.npz", lambda: true)
        assert all(found[name].shape == found["edit"].shape[:2] for name in REGION_MASKS)
        return found

    inputs = inputs_of(whole, {"truth.npz": ["npz"]}) | gone(whole)
    return Reader(folder, whole, read, inputs, (), keeps=False, refuses=False)


def comparison_reader(folder: Path) -> Reader:
    """Rows of an earlier comparison, and its tables."""
    about = {"log": "a", "cases": {"replay": {"frames": [1], "moves_view": False}}}
    camera = {"psnr_db": 20.5, "ssim": 0.8, "actors": {"psnr_db": 18.0}}
    row = {"title": "UniSim", "replay": {"camera": {"edit": camera}, "fid": 10.0}, "made": {"training_s": 60.0}}
    whole = {"comparison.json": json_text({"about": about, "rows": {"unisim": row, "replay": row}})}

    def read() -> object:
        rows = _earlier(folder / "comparison.json", about)
        return comparison_markdown("title", "about", tables_of({"replay": False}), rows)

    inputs = inputs_of(whole, {"comparison.json": ["json"]})
    return Reader(folder, whole, read, inputs, ("comparison.json",))


THUMBNAILS, SURFELS, CELLS = Property(image_reader), Property(surfel_reader), Property(cell_reader)
SPACES, TRUTHS, COMPARISONS = Property(space_reader), Property(truth_reader), Property(comparison_reader)


@given(THUMBNAILS.inputs)
def test_thumbnails_of_actors(changes: Input) -> None:
    THUMBNAILS.check(changes)


@given(SURFELS.inputs)
@example([In("surfels/surfels.json", "json", (Put(("exposures", "front_camera", "time_s", 0), None),))])
@example([In("surfels/surfels.json", "json", (Drop(("exposures", "front_camera", "time_s", 0)),))])
@example([In("surfels/actors_colours.npy", "bytes", (Bytes(10, 1, b"\0"),))])
@example([In("surfels/static_nodes.npy", "bytes", (Bytes(-20, 4, b"\xff\xff\xff\x7f"),))])
def test_surfels(changes: Input) -> None:
    SURFELS.check(changes)


@pytest.mark.skipif(native.library() is None, reason="there is no native library")
@given(CELLS.inputs)
def test_cells(changes: Input) -> None:
    CELLS.check(changes)


@given(SPACES.inputs)
def test_observed_spaces(changes: Input) -> None:
    SPACES.check(changes)


@given(TRUTHS.inputs)
@example([In("truth.npz", "npz", (Copy(("edited",), ("edit",)),))])
@example([In("truth.npz", "npz", (Array("edit", Shape("flat")),))])
@example([In("truth.npz", "npz", (Array("seen", Entry(0, 1)),))])
def test_true_images(changes: Input) -> None:
    TRUTHS.check(changes)


@given(COMPARISONS.inputs)
@example([In("comparison.json", "json", (Put((), []),))])
@example([In("comparison.json", "json", (Put(("rows",), [1]),))])
@example([In("comparison.json", "json", (Put(("rows", "unisim"), 3),))])
@example([In("comparison.json", "json", (Put(("rows", "unisim", "replay", "fid"), []),))])
def test_comparisons(changes: Input) -> None:
    COMPARISONS.check(changes)
