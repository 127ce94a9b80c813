"""Workers on other machines: what renders other bytes than the machine that planned is refused."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from written_street import write_street

from unisim_bench.settings import VARIANTS
from unisim_blender.core import native
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.prepare.scenario_plan import RenderOptions, plan_scenario
from unisim_blender.core.scenes.recipe import RendererRecipe

WORKER = """\
import pickle, sys
from pathlib import Path
from unisim_blender.core.errors import UnisimError
try:
    pickle.loads(Path(sys.argv[1]).read_bytes()).load()
except UnisimError as error:
    sys.exit(str(error))
"""


@pytest.fixture(scope="module")
def recipe(tmp_path_factory: pytest.TempPathFactory) -> RendererRecipe:
    log = write_street(tmp_path_factory.mktemp("street") / "log", 2, columns=60)
    return plan_scenario(log, RenderOptions(renderer="surfel"))[0].recipe


def test_the_machine_that_planned_renders(recipe: RendererRecipe) -> None:
    assert pickle.loads(pickle.dumps(recipe)).load() is not None


def test_another_instruction_set_is_refused(recipe: RendererRecipe, tmp_path: Path) -> None:
    here = native.variant()
    if here not in VARIANTS[1:]:
        pytest.skip("this machine has one instruction set")
    (tmp_path / "maker").write_bytes(pickle.dumps(recipe))
    command = [sys.executable, "-c", WORKER, str(tmp_path / "maker")]
    there = {**os.environ, native.VARIANT_VARIABLE: "portable"}
    done = subprocess.run(command, env=there, capture_output=True, text=True)
    told = f"renders other bytes than the machine that planned this: its instruction_set is portable, not {here};"
    assert done.returncode == 1 and told in done.stderr and done.stderr.count("\n") == 1


def test_other_versions_are_refused(recipe: RendererRecipe) -> None:
    with pytest.raises(UnisimError, match=r"its numpy is .*, not 1\.0;"):
        replace(recipe, environment={**recipe.environment, "numpy": "1.0"}).load()
    with pytest.raises(UnisimError, match="its unisim_blender is another one than that of the machine that planned"):
        replace(recipe, code="0" * 64).load()
