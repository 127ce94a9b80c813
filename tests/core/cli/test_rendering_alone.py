"""The sample rendered by the command line with nothing besides what rendering needs: the test of every
platform's wheel."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from unisim_blender.core import native

SAMPLE = Path(__file__).parents[3] / "sample"
PROGRAM = """
import sys
sys.modules.update(dict.fromkeys(("torch", "scipy", "skimage", "safetensors", "imageio_ffmpeg")))
from unisim_blender.core.cli.main import run
sys.exit(run(sys.argv[1:]))
"""


def unisim(*arguments: object) -> subprocess.CompletedProcess[str]:
    """The command line in an interpreter that cannot import what rendering does without."""
    command = [sys.executable, "-c", PROGRAM, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames of the sample's scene with one edit, all formats."""
    folder = tmp_path_factory.mktemp("alone")
    document = {
        "format": "unisim-scenario",
        "version": 1,
        "name": "alone",
        "log": "nowhere",
        "scene": str(SAMPLE / "scene"),
        "edits": [{"type": "remove", "actor": "car-12"}],
        "outputs": {"passes": ["rgb", "depth", "instance", "normal", "opacity"]},
    }
    (folder / "scenario.json").write_text(json.dumps(document))
    done = unisim(
        "render", folder / "scenario.json", "--out", folder / "out", "--frames", "4:6", "--width", 96, "--jobs", 1
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "out"


def test_the_kernels_are_there() -> None:
    assert native.library() is not None and native.variant() in ("portable", "avx2", "avx512")


def test_a_street_is_to_be_seen(frames: Path) -> None:
    images = [np.asarray(Image.open(path)).astype(float) for path in sorted(frames.glob("camera/*/*.png"))]
    assert len(images) == len(list(frames.glob("camera/*/*.exr"))) == 2
    assert all(image.shape == (54, 96, 3) and image.std() > 30 for image in images)
    assert 1 < np.abs(images[0] - images[1]).mean() < 40, "the vehicle moves, and not far"


def test_beams_return_from_the_street(frames: Path) -> None:
    sweeps = [np.load(path) for path in sorted(frames.glob("lidar/*/*.npz"))]
    assert len(sweeps) == 2
    for sweep in sweeps:
        away = np.hypot(sweep["x"], sweep["y"])
        assert len(away) > 10000 and 3 < np.median(away) < 40
        assert -2.2 < np.percentile(sweep["z"][away < 15], 5) < -1.6, "the ground, a roof's height below the sensor"
        assert len(np.unique(sweep["instance"])) > 4, "and actors"


def test_what_needs_torch_says_so(tmp_path: Path) -> None:
    done = unisim("train", tmp_path, "--out", tmp_path / "out", "--iterations", 1)
    assert done.returncode == 1 and ".[torch]" in done.stderr and "Traceback" not in done.stderr
