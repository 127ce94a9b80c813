"""Words for colours against the paints that the procedural street's cars are known to have."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from unisim_blender.core.actor_images.cache import make_images
from unisim_blender.core.cli.main import unisim
from unisim_blender.core.formats.readers import open_log
from unisim_street.assets.cars import BodyPaint
from unisim_street.layout import lay_out

WORDS = {
    "#b9bcc0": ("light grey", "white"), "#e6e6e2": ("white",), "#1b1d21": ("black",), "#5b6067": ("grey", "light grey"),
    "#8c1d1f": ("red",), "#1f3f77": ("blue",), "#3f6f8f": ("blue",), "#28513a": ("green",), "#c7a13a": ("yellow",),
    "#6e5a48": ("brown", "grey"), "#a9412a": ("orange", "red"),
}  # fmt: skip
"""What a person would call each paint as the sun of the street lights it: silver is nearly white there."""


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_words_are_those_of_the_paints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "street"
    recipe = ["--frames", "2", "--width", "480", "--height", "270", "--seed", str(seed)]
    result = CliRunner().invoke(unisim, ["synth", str(path), *recipe])
    assert result.exit_code == 0, result.output
    layout = lay_out(seed, 2)
    paints = {uid: asset.parts[0].material for uid, asset in layout.assets.items()}
    words = {one.uid: one.word for one in make_images(open_log(path)) if one.word}
    assert len(words) >= 4 and not any(uid.startswith("cone") for uid in words)
    told = {}
    for uid, word in words.items():
        paint = paints[uid]
        assert isinstance(paint, BodyPaint)
        if layout.actors[uid].label != "Medium-sized Truck":  # whose load is white, whatever the cab is
            told[uid] = (word, WORDS[paint.color])
    wrong = {uid: said for uid, said in told.items() if said[0] not in said[1]}
    assert len(wrong) <= len(told) // 5, wrong
