"""One street, opened once for all of these tests."""

from __future__ import annotations

from pathlib import Path

import pytest
from written_street import write_street

pytest.importorskip("carla_driver_interface")
from unisim_blender.core.prepare.scenario_plan import RenderOptions  # noqa: E402
from unisim_blender.core.serve.scenes import ServedScene, open_scenes  # noqa: E402


@pytest.fixture(scope="session")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_street(tmp_path_factory.mktemp("served") / "street", 3, columns=300)


@pytest.fixture(scope="session")
def scenes(street: Path) -> dict[str, ServedScene]:
    return open_scenes([street], RenderOptions(renderer="surfel", quality="fast"))
