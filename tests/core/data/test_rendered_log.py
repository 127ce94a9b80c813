"""Rendered sequences as films and as logs in PandaSet's layout."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image
from tiny_drive import tiny_plan

from unisim_blender.core.errors import OutputError
from unisim_blender.core.export.formats import write_rendered_log, write_sequence
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.sequence.run import render_sequence


def test_log_reads_back(tmp_path: Path) -> None:
    plan = tiny_plan(width=64)
    plan = replace(plan, moments=tuple(plan.moments[frame] for frame in (1, 2, 4)))
    out = tmp_path / "out"
    render_sequence(plan, out)
    log = open_log(write_rendered_log(plan, out))
    assert log.drive.frames == (1, 2, 4)
    png = np.asarray(Image.open(out / "camera/front/000002.png")).astype(int)
    image = log.image("front", 2).astype(int)
    assert image.shape == (36, 64, 3)
    assert np.abs(image - png).mean() < 12, "JPEG of noise is close, not equal"
    with np.load(out / "lidar/top/000002.npz") as arrays:
        assert len(log.sweep("top", 2).points) == len(arrays["x"])
        world = (
            np.stack([arrays[a] for a in "xyz"], -1) @ arrays["world_from_lidar"][:3, :3].T
            + arrays["world_from_lidar"][:3, 3]
        )
    found = log.sweep("top", 2).points
    np.testing.assert_allclose(found[np.lexsort(found.T)], world[np.lexsort(world.T)], atol=1e-4)
    assert "car" in log.drive.actors


def test_log_needs_its_files(tmp_path: Path) -> None:
    plan = tiny_plan(frames=1)
    plan = replace(plan, settings=replace(plan.settings, formats=("exr", "npz")))
    render_sequence(plan, tmp_path / "out")
    assert not list((tmp_path / "out").rglob("*.png")), "only what was asked for is written"
    with pytest.raises(OutputError, match="png"):
        write_rendered_log(plan, tmp_path / "out")


def test_film_has_every_frame(tmp_path: Path) -> None:
    plan = tiny_plan(width=65)
    render_sequence(plan, tmp_path / "out")
    write_sequence("video", plan, tmp_path / "out")
    reader = imageio_ffmpeg.read_frames(str(tmp_path / "out/camera/front.mp4"))
    meta = next(reader)
    assert meta["source_size"] == (64, 36) and meta["fps"] == pytest.approx(10, abs=0.01)
    assert sum(1 for _ in reader) == 6
