"""Programs in a fresh interpreter that cannot import some packages."""

from __future__ import annotations

import subprocess
import sys

BLOCKED = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {names!r}:
            raise ModuleNotFoundError(f"{{name}} is blocked", name=name)
sys.meta_path.insert(0, Blocked())
"""


def run_without(blocked: tuple[str, ...], program: str) -> subprocess.CompletedProcess[str]:
    """Run a program in a Python that has none of the blocked packages."""
    return subprocess.run(
        [sys.executable, "-c", BLOCKED.format(names=blocked) + program],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
