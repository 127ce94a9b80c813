"""The Python interpreter that renders: the one chosen in the preferences, else Blender's own, which can without torch;
and a test of it, whose report the preferences show. Training takes the first that has torch."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import bpy

from ..bridge.window import redraw
from ..preferences import interpreter
from ..translations import message

PYTHON = f"python{sys.version_info.major}.{sys.version_info.minor}"


def _packages_folder() -> Path:
    name = __package__.rpartition(".")[0]
    try:
        own = bpy.utils.extension_path_user(name)
    except ValueError:  # it runs from its sources
        own = bpy.utils.user_resource("SCRIPTS", path="unisim_blender")
    return Path(own, "packages", PYTHON)


PACKAGE = Path(__file__).resolve().parents[1]
BOOTSTRAP = PACKAGE / "bootstrap.py"
WHEELS = Path(bpy.utils.user_resource("EXTENSIONS"), ".local", "lib", PYTHON, "site-packages")
"""The folder into which Blender unpacks the wheels of its extensions."""
MODULES = Path(bpy.utils.user_resource("SCRIPTS"), "addons", "modules")
"""The folder of a user's own packages, searched after Blender's: what some layouts of logs need is installed there."""
PACKAGES = _packages_folder()
"""The extension's own folder of optional packages for this Python, a folder each."""
PROBE_TIMEOUT_S = 120
"""A cold import of torch from a slow disk takes half a minute."""
HOW_TO_MEND = (
    "Run make setup in the folder of the sources, or pip install '.[torch]' there, and name that interpreter in "
    "Preferences > Add-ons > UniSim"
)
PYTHON_VARIABLE = "UNISIM_PYTHON"
"""Environment variable that names an interpreter, for where preferences are not at hand."""
POLL_S = 0.2


@dataclass(frozen=True)
class Probe:
    """Answer of an interpreter: ``about`` as `core.worker.about`, or in ``problem`` one line why it cannot render."""

    path: str
    about: dict[str, Any] = field(default_factory=dict)
    problem: str = ""


def command(interpreter: str, *arguments: str) -> list[str]:
    """The command line that runs the bootstrap, apart from the user's own packages and variables."""
    folders = os.pathsep.join(map(str, (WHEELS, MODULES, *package_folders())))
    return [interpreter, "-I", str(BOOTSTRAP), folders, *arguments]


def package_folders() -> list[Path]:
    """Return the folders of the optional packages that are installed in `PACKAGES`."""
    return sorted(PACKAGES.glob("[!.]*"))


def candidates(chosen: str = "") -> Iterator[str]:
    """Interpreters to try, each once, the likeliest to be meant first."""
    seen: set[str] = set()
    for path in (chosen, os.environ.get(PYTHON_VARIABLE, ""), sys.executable, *_installed()):
        if path and path not in seen and Path(path).is_file():
            seen.add(path)
            yield path


def _installed() -> Iterator[str]:
    """The environment that `make setup` leaves beside the sources, and that of the console script on the path."""
    for name in ("bin/python", "Scripts/python.exe"):
        yield str(PACKAGE.parent / ".venv" / name)
    script = shutil.which("unisim")
    if script:
        for name in ("python", "python3", "python.exe"):
            yield str(Path(script).resolve().with_name(name))


def probe(path: str) -> Probe:
    """Ask an interpreter what it has. Takes seconds: not for the thread that draws."""
    try:
        done = subprocess.run(command(path, "probe"), capture_output=True, timeout=PROBE_TIMEOUT_S, check=False)
        if done.returncode == 0:
            return Probe(path, json.loads(done.stdout))
        lines = done.stderr.decode(errors="replace").strip().splitlines()
        return Probe(path, problem=lines[-1] if lines else f"ended with exit status {done.returncode}")
    except subprocess.TimeoutExpired:
        return Probe(path, problem=f"gave no answer in {PROBE_TIMEOUT_S} s")
    except (OSError, ValueError) as fault:
        return Probe(path, problem=str(fault))


def find(chosen: str = "", training: bool = False) -> tuple[Probe | None, list[Probe]]:
    """The first interpreter that can render, or even train, and those that were tried before and cannot."""
    failed: list[Probe] = []
    for path in candidates(chosen):
        result = probe(path)
        if training and not result.problem and result.about["training_lacks"]:
            result = replace(result, problem=f"has no {' and no '.join(result.about['training_lacks'])}")
        if not result.problem:
            return result, failed
        failed.append(result)
    return None, failed


def how_to_mend(failed: list[Probe], training: bool = False) -> str:
    """For a user whose machine has no interpreter that can render, or train: what was tried, and what to do."""
    tried = "; ".join(f"{failure.path}: {failure.problem}" for failure in failed) or "none was found"
    what = "train, which needs torch" if training else "render"
    return f"no Python interpreter here can {what} ({tried}). {HOW_TO_MEND}"


def report_of(chosen: str) -> str:
    """Return lines on the interpreter that renders, and on those that were tried before it."""
    python, failed = find(chosen)
    lines = [f"{failure.path}: {failure.problem}" for failure in failed]
    if python is None:
        return "\n".join([*lines, HOW_TO_MEND])
    about = python.about
    torch = f", torch {about['torch']}" if about["torch"] else ""
    memory = f", {about['memory_bytes'] / 2**30:.0f} GiB" if about["memory_bytes"] else ""
    said = [
        message("Renders with {path}", path=python.path),
        message("Python {version}, kernels: {kernels}", version=f"{about['python']}{torch}", kernels=about["kernels"]),
        f"{', '.join(about['devices'])}{memory}",
        *about["warnings"],
    ]
    if about["training_lacks"]:
        said.append(message("Training needs an interpreter with torch, named above"))
    return "\n".join([*said, *lines])


class UNISIM_OT_test_renderer(bpy.types.Operator):
    """Find an interpreter that can render and show its capabilities"""

    bl_label = "Test Renderer"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ask in a thread; without a window, wait."""
        chosen, answer = interpreter(), []
        thread = threading.Thread(target=lambda: answer.append(report_of(chosen)), daemon=True)
        thread.start()
        context.window_manager.unisim_renderer = message("Searching…")

        def tell() -> float | None:
            if thread.is_alive():
                return POLL_S
            bpy.context.window_manager.unisim_renderer = answer[0] if answer else message("The test failed")
            redraw()
            return None

        if bpy.app.background:
            thread.join()
            tell()
        else:
            bpy.app.timers.register(tell, first_interval=POLL_S, persistent=True)
        return {"FINISHED"}
