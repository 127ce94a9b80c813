"""`unisim synth --lens`: the log's cameras have the lens, its images are drawn through it, and the recipe says so."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from unisim_blender.core.errors import LogError
from unisim_blender.core.evaluation.metrics import psnr
from unisim_blender.core.formats.common.sensor_file import read_setup
from unisim_blender.core.formats.pandaset.write import PandasetWriter
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.lenses import PINHOLE
from unisim_blender.core.sensors.camera import pixel_grid
from unisim_blender.core.sensors.unprojection import has_direction
from unisim_street.commands.synth import LENSES, command
from unisim_street.street import DEFAULT_LENS, STREET_LENSES, Recipe, Street, build_street, load_street, recipe_document
from unisim_street.truth import truth_camera

CAMERA, WIDTH, HEIGHT = "front_camera", 96, 54
BENT = [name for name in STREET_LENSES if name != DEFAULT_LENS]


def test_the_command_has_every_lens() -> None:
    assert set(LENSES) == set(STREET_LENSES)
    types = {chosen.lens.TYPE for chosen in STREET_LENSES.values()}
    assert types == {"pinhole", "opencv_pinhole", "opencv_fisheye", "f_theta", "mei"}


@pytest.fixture(scope="module")
def plain() -> Street:
    return build_street(7, 2, WIDTH, HEIGHT)


@pytest.mark.parametrize("name", BENT)
def test_an_image_spans_what_the_lens_says_and_the_log_keeps_the_lens(name: str, plain: Street, tmp_path: Path) -> None:
    street = build_street(7, 2, WIDTH, HEIGHT, lens=name)
    PandasetWriter(tmp_path, street.drive).finish()
    setup, model = read_setup(tmp_path), street.drive.cameras[CAMERA].model
    assert setup is not None and setup.lenses[CAMERA] == model.lens == STREET_LENSES[name].lens != PINHOLE
    ends = model.unproject(np.array([0.0, WIDTH]), np.array([HEIGHT / 2, HEIGHT / 2]))
    angles = np.degrees(np.arctan2(ends[:, 0], ends[:, 2]))
    usual = 2 * np.degrees(np.arctan(WIDTH / 2 / plain.drive.cameras[CAMERA].model.fx))
    across = STREET_LENSES[name].across_deg or usual
    assert angles[1] == pytest.approx(across / 2, abs=0.2) and angles[0] == pytest.approx(-across / 2, abs=0.2)
    assert has_direction(model, *pixel_grid(model)).mean() > 0.9


def test_the_command_draws_through_the_lens(plain: Street, tmp_path: Path) -> None:
    out = tmp_path / "log"
    options = ["--frames", "2", "--width", str(WIDTH), "--height", str(HEIGHT), "--seed", "7", "--lens", "fisheye"]
    result = CliRunner().invoke(command, [str(out), *options, "--jobs", "1", "--quiet"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    street, log = load_street(out), open_log(out)
    assert street.recipe.lens == "fisheye" and log.drive.cameras[CAMERA].model == street.drive.cameras[CAMERA].model
    recorded = log.image(CAMERA, 1) / 255
    assert psnr(recorded, truth_camera(street, street.drive, CAMERA, 1).rgb) > 30
    assert psnr(recorded, truth_camera(plain, plain.drive, CAMERA, 1).rgb) < 25


def test_a_recipe_without_a_lens_is_as_it_was(tmp_path: Path) -> None:
    document = recipe_document(Recipe())
    assert "lens" not in document and recipe_document(Recipe(lens="mei"))["lens"] == "mei"
    path = tmp_path / "street.json"
    for lens in ("eye", ["mei"], None):
        path.write_text(json.dumps({**document, "lens": lens}))
        with pytest.raises(LogError, match=r"street\.json: a street's lens is one of pinhole, opencv, .* not"):
            load_street(path)
