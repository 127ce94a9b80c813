"""Presets: the registry, what each states, and where its names are shown."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import pytest
from click.testing import CliRunner

from unisim_blender.core.cli.main import unisim
from unisim_blender.core.errors import SceneError
from unisim_blender.core.model.config import ModelConfig
from unisim_blender.core.prepare.renderers import RENDERERS
from unisim_blender.core.presets import PRESETS, Ablation, methods, preset, register
from unisim_blender.core.training.config import ABLATIONS, TrainConfig, recipe

CONFIG = TrainConfig(cameras=("front_camera",), lidars=("pandar64",), frames=(0, 2))


def test_every_preset_is_registered_by_its_name_and_shown_to_people() -> None:
    assert list(PRESETS) == [one.name for one in PRESETS.values()] and "tiny" in PRESETS
    shown = " ".join(CliRunner().invoke(unisim, ["train", "--help"], terminal_width=10_000).output.split())
    for one in PRESETS.values():
        assert one.title and one.about and not one.about.endswith("."), one.name
        assert f"{one.name}, {one.about[0].lower()}{one.about[1:]}" in shown
    with pytest.raises(SceneError, match="no preset 'huge': there are tiny, "):
        preset("huge")


def test_every_method_has_a_renderer_of_trained_scenes() -> None:
    assert set(methods()) == {name for name, one in RENDERERS.items() if one.trained}
    assert {"neural", "ngp", "nsg"} <= set(methods())


def test_a_name_that_is_taken_is_refused() -> None:
    before = dict(PRESETS)
    with pytest.raises(ValueError, match="there is a preset 'tiny' already"):
        register(replace(preset("small"), name="tiny"))
    assert before == PRESETS


@pytest.mark.parametrize("name", PRESETS)
def test_shapes_are_kept_as_scene_json_has_them(name: str) -> None:
    shapes = preset(name).model
    assert ModelConfig.from_dict(shapes.to_dict()) == shapes


@pytest.mark.parametrize("name", PRESETS)
def test_an_ablation_changes_something_and_what_is_not_listed_is_refused(name: str) -> None:
    stated = preset(name)
    assert recipe(replace(CONFIG, preset=name)) == stated, "a training without options does what the preset states"
    assert set(ABLATIONS) == set(get_args(Ablation))
    for ablation in ABLATIONS:
        config = replace(CONFIG, preset=name, without=(ablation,))
        if ablation in stated.ablations:
            assert recipe(config) != stated
        else:
            with pytest.raises(SceneError, match=f"preset '{name}' cannot do without '{ablation}', only without "):
                recipe(config)
    for density in ("logistic", "unisim"):
        config = replace(CONFIG, preset=name, density=density)
        if density in stated.densities:
            assert recipe(config).model.density == density
        else:
            with pytest.raises(SceneError, match="does not take a density"):
                recipe(config)


def test_a_baseline_has_no_term_of_signed_distances() -> None:
    for one in (preset("ngp"), preset("nsg")):
        absent = {name for name, weight in vars(one.weights).items() if not weight}
        geometry = {
            "sdf_band",
            "eikonal",
            "normal_smoothness",
            "distortion",
            "unobserved",
            "lidar_free",
            "lidar_opacity",
        }
        assert geometry | {"perceptual", "chroma"} <= absent
        assert one.is_baseline and not one.refines_tracklets and not one.refines_cameras and not one.mirrored
