"""The film of a finished run: what stands where in its frames, as MP4 and as a page."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from exported_run import FRAMES, render_tiny, render_turn
from PIL import Image

from unisim_blender.core.cli.main import unisim
from unisim_blender.core.errors import OutputError, UnisimError
from unisim_blender.core.export import film
from unisim_blender.core.export.film import BOX, CAPTION, EGO_BOX, WIDTH, write_film
from unisim_blender.core.formats.rendered import camera_path
from unisim_blender.core.output.video import _frames_of

SAMPLE = Path(__file__).parents[3] / "sample" / "scenario.json"
FEW = 12
"""Largest difference of pixels that JPEG leaves in even parts."""


def frames_of(page: Path) -> list[np.ndarray[Any, Any]]:
    """The frames that a page plays, in order."""
    names = json.loads(re.search(r"frames = (\[.*?\])", page.read_text())[1])  # type: ignore[index]
    return [np.asarray(Image.open(page.parent / name)) for name in names]


def test_each_frame_has_its_image_beside_its_sweep(tmp_path: Path) -> None:
    folder = render_tiny(tmp_path / "run")
    done: list[tuple[int, int]] = []
    page = write_film(folder, out=tmp_path / "film.html", on_frame=lambda *count: done.append(count))
    shown = frames_of(page)
    assert done == [(number, len(FRAMES)) for number in (1, 2, 3)] and len(shown) == len(FRAMES)
    high = shown[0].shape[0] - CAPTION
    wide = shown[0].shape[1] - high  # what is seen from above is square
    assert WIDTH - 4 <= wide + high <= WIDTH
    for number, frame in zip(FRAMES, shown, strict=True):
        image = Image.open(camera_path(folder, "front", f"{number:06d}", ".png")).convert("RGB")
        small = np.asarray(image.resize((4, 4), Image.Resampling.BOX), float)
        there = np.asarray(Image.fromarray(frame[:high, :wide]).resize((4, 4), Image.Resampling.BOX), float)
        assert np.abs(small - there)[1:].max() < FEW  # the name is in the first row
        above = frame[:high, wide:].astype(float)
        for colour in (BOX, EGO_BOX):
            assert (np.abs(above - colour).max(-1) < 60).any()
    assert np.abs(shown[0].astype(float) - shown[2]).max() > 50


def test_sensors_are_chosen_and_the_rate_is_that_of_the_run(tmp_path: Path) -> None:
    folder, drive = render_turn(tmp_path / "run")
    only = frames_of(write_film(folder, ["front"], tmp_path / "only.html"))
    model = drive.cameras["front"].model
    assert only[0].shape[1] / (only[0].shape[0] - CAPTION) == pytest.approx(model.width / model.height, rel=0.02)
    assert len(only) == len(drive.frames)
    above = frames_of(write_film(folder, ["top"], tmp_path / "above.html"))
    assert above[0].shape[0] - CAPTION == above[0].shape[1]
    with pytest.raises(OutputError, match=r'has nothing of a sensor "rear" \(there are front, top\)'):
        write_film(folder, ["rear"])


def test_the_command_writes_mp4_and_a_page_without_ffmpeg(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = render_tiny(tmp_path / "run")
    result = CliRunner().invoke(unisim, ["film", str(folder), "--json"])
    events = [json.loads(line) for line in result.output.splitlines() if line.startswith("{")]
    assert events[-1] == {"file": str(folder / "film.mp4")} and events[0] == {"done": 1, "total": 3}
    assert _frames_of(folder / "film.mp4") >= len(FRAMES)
    monkeypatch.setattr(film, "find_spec", lambda name: None)
    result = CliRunner().invoke(unisim, ["film", str(folder)])
    assert result.exit_code == 0 and "imageio-ffmpeg is missing" in result.output, result.output
    assert len(frames_of(folder / "film.html")) == len(FRAMES)


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    with pytest.raises(UnisimError, match="is not rendered to its end"):
        write_film(tmp_path / "none")
    folder = render_tiny(tmp_path / "run")
    camera_path(folder, "front", "000001", ".png").unlink()
    with pytest.raises(OutputError, match=r"000001\.png: is missing or no image; a film is made of png files"):
        write_film(folder, out=tmp_path / "film.html")
    assert not (tmp_path / "film.html").exists()


def test_a_missing_package_is_said_before_anything_is_rendered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    command = ["render", str(SAMPLE), "--out", str(tmp_path / "out"), "--frames", "5", "--format", "video"]
    result = CliRunner().invoke(unisim, command)
    assert isinstance(result.exception, ModuleNotFoundError) and not list(tmp_path.rglob("*.png"))
