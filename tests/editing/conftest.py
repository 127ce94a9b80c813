"""Helper modules of these tests are imported by name. No Blender is needed: nothing here imports bpy."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from written_street import write_recipe

from unisim_blender.editing.sampled.source import DriveSource, open_source

sys.path.insert(0, str(Path(__file__).parent))

SAMPLE = Path(__file__).parents[2] / "sample"


@pytest.fixture(scope="session")
def source(tmp_path_factory: pytest.TempPathFactory) -> DriveSource:
    """The sample's trained scene; the log that it was trained on is not at hand."""
    return open_source(str(tmp_path_factory.mktemp("no") / "log"), str(SAMPLE / "scene"))


@pytest.fixture(scope="session")
def street_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of a procedural street, a few frames long."""
    return write_recipe(tmp_path_factory.mktemp("log") / "street", frames=3, width=96, height=54)
