"""Helper modules of these tests are imported by name, in worker processes too. What is kept for later is
kept nowhere else."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path[:0] = [str(Path(__file__).parent / name) for name in ("support", "core", "reference")]
# else imageio forks before it starts ffmpeg, and gRPC's threads in the child close the pipes to it
os.environ.setdefault("IMAGEIO_FFMPEG_NO_PREVENT_SIGINT", "1")


@pytest.fixture(scope="session", autouse=True)
def _cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    os.environ["UNISIM_CACHE"] = str(tmp_path_factory.mktemp("cache"))
    yield
    del os.environ["UNISIM_CACHE"]


@pytest.fixture(scope="session", autouse=True)
def _shared_folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    """One folder of all workers of a run, for `written_once`."""
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "shared"
    shared.mkdir(exist_ok=True)
    os.environ["UNISIM_TEST_FOLDERS"] = str(shared)
