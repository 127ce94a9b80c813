"""A frame holds the passes that were asked for and no other, whatever traces it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from drive_frames import DriveFrames
from random_scene import CARS, CONFIGS, TINY, edited, saved

from unisim_blender.core import native
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.output.frame_files import exr_channels
from unisim_blender.core.render.quality import QUALITIES
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracer import Backend
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.render.tracers.torch.tracer import TorchBackend
from unisim_blender.core.sensors.frames import CAMERA_PASSES, CameraFrame

FIELDS = {
    "depth": {"depth_m", "z_depth_m"}, "normal": {"normal"}, "instance": {"instance"}, "opacity": {"opacity"},
    "unsupported": {"unsupported"},
    "confidence": {"confidence"},
}  # fmt: skip
ASKED = [("rgb",), *(("rgb", name) for name in FIELDS), ("rgb", "normal", "unsupported"), CAMERA_PASSES]
TRACERS = ("torch", *(("compiled",) if native.library() is not None else ()))


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Scenes whose images are traced cell by cell, and from a lattice."""
    folder = tmp_path_factory.mktemp("passes")
    lattice = dataclasses.replace(TINY, upsample=1, decoder_kernel=1, decoder_blocks=1)
    return {"cells": saved(folder / "cells", CONFIGS["tiny"]), "lattice": saved(folder / "lattice", lattice)}


def backend_of(name: str, folder: Path) -> Backend:
    return CompiledBackend(CompiledScene(folder)) if name == "compiled" else TorchBackend(load_scene(folder))


def held(frame: CameraFrame) -> set[str]:
    every: set[str] = set().union(*FIELDS.values())
    return {name for name in every if getattr(frame, name) is not None}


@pytest.mark.parametrize("shadows", (False, True))
@pytest.mark.parametrize("kind", ("cells", "lattice"))
@pytest.mark.parametrize("name", TRACERS)
def test_a_frame_holds_what_was_asked_for(folders: dict[str, Path], name: str, kind: str, shadows: bool) -> None:
    drive = edited(CARS)
    if shadows:
        drive = dataclasses.replace(
            drive, actors={u: dataclasses.replace(a, inserted=True) for u, a in drive.actors.items()}
        )
    renderer = DriveFrames(Renderer(backend_of(name, folders[kind]), shadows), drive)
    channels: dict[str, set[str]] = {}
    for passes in ASKED:
        frame = renderer.camera("front", 2, passes)
        assert held(frame) == set().union(*(FIELDS[one] for one in passes if one != "rgb")), passes
        channels["+".join(passes)] = set(exr_channels(frame))
    assert channels["rgb"] == {"R", "G", "B", "A"} and channels["rgb+unsupported"] == {
        "R",
        "G",
        "B",
        "A",
        "unsupported",
    }


@pytest.mark.parametrize("kind", ("cells", "lattice"))
@pytest.mark.skipif(len(TRACERS) < 2, reason="the kernels were not built")
def test_the_tracers_passes_are_alike(folders: dict[str, Path], kind: str) -> None:
    """Every pass alone, by both: where kernels and torch differ, at silhouettes, they do in few pixels."""
    drive = edited(CARS)
    renderers = []
    for name in TRACERS:
        renderer = Renderer(backend_of(name, folders[kind]))
        renderer.quality = QUALITIES["reference"]
        renderers.append(DriveFrames(renderer, drive))
    a, b = (renderer.camera("front", 2, CAMERA_PASSES) for renderer in renderers)
    for field, within in (("rgb", 2e-4), *((name, 2e-3) for name in sorted(set().union(*FIELDS.values())))):
        x, y = np.asarray(getattr(a, field), float), np.asarray(getattr(b, field), float)
        assert field == "unsupported" or len(np.unique(y)) > 1, f"{field} has nothing to compare"
        same = (np.isclose(x, y, rtol=within, atol=within) | (x == y)).reshape(*x.shape[:2], -1).all(-1)
        # recorded views are traced with the quality fast, in which the tracers place their samples otherwise
        most = 0.05 * same.size if field == "confidence" else 2
        assert (~same).sum() <= most, f"{field}: {(~same).sum()} of {same.size} pixels differ"
