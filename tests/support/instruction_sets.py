"""The kernels' instruction sets that run here, and scripts in processes of theirs."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from unisim_bench.settings import VARIANTS
from unisim_blender.core import native

START = """
import sys
sys.path[:0] = {folders!r}
from unisim_blender.core import native
assert native.variant() == {name!r}, native.variant()
"""


def sets_here() -> tuple[str, ...]:
    """Those that the processor and the build have, the oldest first; none without the kernels."""
    return VARIANTS[: VARIANTS.index(native.variant()) + 1] if native.library() is not None else ()


GPU_ON_CPU = "cuda_on_cpu"
"""The variant of the kernels that traces as a GPU does."""


def run_with(name: str, script: str, *arguments: object) -> None:
    """Run a script, which finds the tests' modules, with the kernels of one set; the test is skipped where
    that does not run."""
    if name not in (*sets_here(), GPU_ON_CPU) or native.library() is None:
        pytest.skip(f"this processor or build has no {name}")
    here = Path(__file__).parent
    start = START.format(folders=[str(here.parent / part) for part in ("support", "core", "reference")], name=name)
    command = [sys.executable, "-c", start + script, *map(str, arguments)]
    environment = {**os.environ, "UNISIM_NATIVE_VARIANT": name, "OMP_NUM_THREADS": "1"}
    run = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr


def run_other(name: str, script: str, *arguments: object) -> None:
    """Run a script of a file's own tests with the kernels of one set, as `run_with` does; the test is skipped for the set that
    the file's tests themselves run with."""
    if native.library() is not None and name == native.variant():
        pytest.skip("the tests of this process run with it")
    run_with(name, script, *arguments)
