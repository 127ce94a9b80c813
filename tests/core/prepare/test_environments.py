"""Workers on other machines: what renders other bytes than the machine that planned is refused."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import cast

import pytest
from written_street import write_street

from unisim_bench.methods import VARIANTS
from unisim_blender.core import native
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.prepare.environments import CheckedMaker
from unisim_blender.core.prepare.scenario_plan import RenderOptions, plan_scenario

WORKER = """\
import pickle, sys
from pathlib import Path
from unisim_blender.core.errors import UnisimError
try:
    pickle.loads(Path(sys.argv[1]).read_bytes())()
except UnisimError as error:
    sys.exit(str(error))
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> CheckedMaker:
    log = write_street(tmp_path_factory.mktemp("street") / "log", 2, columns=60)
    return cast(CheckedMaker, plan_scenario(log, RenderOptions(renderer="surfel"))[0].make_renderer)


def test_the_machine_that_planned_renders(made: CheckedMaker) -> None:
    assert pickle.loads(pickle.dumps(made))() is not None


def test_another_instruction_set_is_refused(made: CheckedMaker, tmp_path: Path) -> None:
    here = native.variant()
    if here not in VARIANTS[1:]:
        pytest.skip("this machine has one instruction set")
    (tmp_path / "maker").write_bytes(pickle.dumps(made))
    command = [sys.executable, "-c", WORKER, str(tmp_path / "maker")]
    there = {**os.environ, native.VARIANT_VARIABLE: "portable"}
    done = subprocess.run(command, env=there, capture_output=True, text=True)
    told = f"renders other bytes than the machine that planned this: its instruction_set is portable, not {here};"
    assert done.returncode == 1 and told in done.stderr and done.stderr.count("\n") == 1


def test_other_versions_are_refused(made: CheckedMaker) -> None:
    with pytest.raises(UnisimError, match=r"its numpy is .*, not 1\.0;"):
        replace(made, planned={**made.planned, "numpy": "1.0"})()
    with pytest.raises(UnisimError, match="its unisim_blender is another one than that of the machine that planned"):
        replace(made, code="0" * 64)()
