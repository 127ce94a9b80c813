"""A .blend rendered without a window: its scenario is written, and the command line `unisim render` does the rest.

python -m unisim_blender render drive.blend --out DIR [options of unisim render]
blender -b drive.blend --command unisim render --out DIR [options of unisim render]
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from .core.errors import UnisimError
from .process import interpreters


def render_file(path: Path, arguments: Sequence[str]) -> int:
    """Open a .blend with Blender's module and render it; the exit code."""
    import bpy

    from . import register, unregister

    if not path.is_file():
        return _fail(f"{path}: there is no such file")
    register()
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path.absolute()))  # Blender has its own idea of the working folder
        return render_scene(bpy.context.scene, arguments)
    except RuntimeError as fault:  # Blender's own words
        return _fail(f"{path}: {str(fault).strip()}")
    finally:
        unregister()


def render_scene(scene: object, arguments: Sequence[str]) -> int:
    """Render what a scene stands for; the exit code."""
    from .editing.reading.scenario import write_scenario
    from .features.drive.export_operators import scenario_of
    from .preferences import interpreter

    try:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "scenario.json"
            write_scenario(scenario_of(scene, file), file)
            python, failed = interpreters.find(interpreter())
            if python is None:
                return _fail(interpreters.how_to_mend(failed))
            return subprocess.run(
                interpreters.command(python.path, "cli", "render", str(file), *arguments), check=False
            ).returncode
    except (UnisimError, OSError) as fault:
        return _fail(str(fault))


def command(arguments: Sequence[str]) -> int:
    """`blender --command unisim`: the open file's scene."""
    import bpy

    what, *rest = arguments or [""]
    if what != "render":
        return _fail(
            f'"{what}": is not a command of unisim here; there is: render --out DIR [options of unisim render]'
        )
    return render_scene(bpy.context.scene, rest)


def _fail(sentence: str) -> int:
    print(f"Error: {sentence}", file=sys.stderr)
    return 1
