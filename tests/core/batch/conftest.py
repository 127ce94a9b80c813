"""One street for all tests of batches."""

from __future__ import annotations

from pathlib import Path

import pytest
from written_street import write_street


@pytest.fixture(scope="session")
def small_street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a street of three small frames."""
    return write_street(tmp_path_factory.mktemp("street") / "street", 3, columns=180)
