"""Wires, masts, railings and fences: they are where their mask says, and the rest of the street is what it is without them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.thin_things import main
from unisim_blender.core.errors import LogError
from unisim_street.street import RECIPE_FILE, Recipe, build_street, load_street, recipe_document
from unisim_street.truth import make_world, thin_share, truth_camera


def test_thin_things_are_the_pixels_of_their_mask(tmp_path: Path) -> None:
    plain, thin = (build_street(3, 4, 160, 90, thin=with_thin) for with_thin in (False, True))
    assert "thin" not in recipe_document(plain.recipe) and not plain.thin
    assert len(thin.static.parts) - thin.thin == len(plain.static.parts)
    camera = thin.drive.cameras["front_camera"]
    share = thin_share(make_world(thin, thin.drive), thin.thin, camera, camera.time_s[1], samples=2)
    assert share.shape == (90, 160) and 0.003 < (share > 0).mean() < 0.1 and share.max() <= 1
    images = [truth_camera(street, street.drive, "front_camera", 1).rgb for street in (plain, thin)]
    difference = np.abs(images[1] - images[0]).max(-1)
    # beside them only their shadows are new
    assert difference[share > 0.4].mean() > 0.05 and np.median(difference[share > 0]) > 0.01
    assert (difference[share == 0] > 1e-6).mean() < 0.05

    (tmp_path / RECIPE_FILE).write_text(json.dumps(recipe_document(thin.recipe)))
    assert load_street(tmp_path).recipe == thin.recipe


def test_a_recipe_says_yes_or_no() -> None:
    with pytest.raises(LogError, match="a street's thin is true or false, not 1"):
        Recipe(thin=1)  # type: ignore[arg-type]


def test_a_scene_that_never_saw_them_recalls_none_and_lets_the_sky_through(tmp_path: Path) -> None:
    street = build_street(0, 20, 480, 270, ("front_camera",), thin=True)
    (tmp_path / RECIPE_FILE).write_text(json.dumps(recipe_document(street.recipe)))
    scene = str(Path(__file__).parents[2] / "sample" / "scene")
    asked = [str(tmp_path), scene, "--width", "160", "--frames", "9", "--shift", "0"]
    done = CliRunner().invoke(main, asked, catch_exceptions=False)
    said = re.fullmatch(
        r"\+0\.0 m: ([\d.]+) % of (\d+) pixels recalled, .* ([\d.]+) % of the sky stopped before 80 m\n", done.output
    )
    assert said is not None, done.output
    recalled, pixels, stopped = (float(number) for number in said.groups())
    assert recalled < 15 and pixels > 50 and stopped < 5
