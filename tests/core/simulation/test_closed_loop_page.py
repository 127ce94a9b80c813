"""The page of the closed loop states every model's parameters, with their defaults, and every driver."""

from __future__ import annotations

from dataclasses import MISSING, fields
from pathlib import Path

from unisim_blender.core.simulation.actors.model import MODELS
from unisim_blender.core.simulation.actors.models.idm import Idm
from unisim_blender.core.simulation.drivers import DRIVERS

PAGE = " ".join(
    (Path(__file__).parents[3] / "docs" / "reference" / "closed-loop.md").read_text(encoding="utf-8").split()
)


def test_every_model_and_parameter() -> None:
    assert issubclass(MODELS["idm"], Idm)
    for name, kind in MODELS.items():
        assert f"| `{name}` |" in PAGE, name
        for field in fields(kind):
            stated = f"`{field.name}`" if field.default is MISSING else f"`{field.name}` ({field.default:g})"
            assert stated in PAGE, f"{name}: {stated}"


def test_every_driver() -> None:
    assert all(f"| `{name}` |" in PAGE for name in DRIVERS)
