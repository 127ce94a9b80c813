"""Two trees of the project, each with its own native library, and the command line of each."""

from __future__ import annotations

import filecmp
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from .cases import Case
from .difference import Intended

LIBRARY = "_unisim_native"
NATIVE = ("CMakeLists.txt", "native")
"""What the native library is built from."""
LIMIT_S = 1800


class TreeError(Exception):
    """One sentence about a tree that cannot be used."""


@dataclass(frozen=True)
class Tree:
    """A tree of the project in ``root``; what its cases write goes below ``out``."""

    name: str
    root: Path
    out: Path

    def run(self, case: Case, inputs: Path, made: Path) -> str:
        """Run a case into its folder; what went wrong in one sentence, or nothing."""
        folder = self.out / case.name
        folder.mkdir(parents=True)
        places = {"inputs": str(inputs), "made": str(made), "out": str(folder)}
        done = self._python(
            "-m", "unisim_blender", *(part.format(**places) for part in case.arguments), environment=case.environment
        )
        if done.returncode != 0:
            said = done.stderr.strip().splitlines() or ["nothing"]
            return f"{self.name} ends with {done.returncode}: {said[-1]}"
        for checkpoint in folder.rglob("checkpoint.safetensors"):  # hundreds of megabytes that no case reads
            checkpoint.unlink()
        if case.prints:
            (folder / "printed.txt").write_text(done.stdout)
        return ""

    def check(self) -> None:
        """Raise `TreeError` where Python takes the package from elsewhere."""
        done = self._python("-c", "import unisim_blender; print(unisim_blender.__file__)", environment={})
        place = done.stdout.strip()
        if done.returncode != 0 or self.root not in Path(place).resolve().parents:
            raise TreeError(f"{self.root}: its package is not what Python imports, but {place or done.stderr.strip()}")

    def _python(self, *arguments: str, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
        """Python without its site module: an editable install would put its own tree before this one."""
        packages = [place for place in sys.path if place.endswith(("site-packages", "dist-packages"))]
        variables = {name: value for name, value in os.environ.items() if not name.startswith("UNISIM_")}
        variables |= {
            "PYTHONPATH": os.pathsep.join([str(self.root), *packages]),
            "OMP_NUM_THREADS": "1",
            "UNISIM_CACHE": str(self.out / "cache"),
            **environment,
        }
        command = [sys.executable, "-S", *arguments]
        try:
            return subprocess.run(command, env=variables, cwd=self.out, capture_output=True, text=True, timeout=LIMIT_S)
        except subprocess.TimeoutExpired:
            return subprocess.CompletedProcess(command, 124, "", f"it took longer than {LIMIT_S} s")


def instruction_set(folder: Path) -> str:
    """The one that a rendered sequence says it was rendered with; nothing where there is none."""
    for file in sorted(folder.rglob("manifest.json")):
        return str(json.loads(file.read_bytes())["environment"].get("instruction_set", ""))
    return ""


def git(root: Path, *arguments: str) -> str:
    """What a command of git says. Raises `TreeError`."""
    done = subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, text=True)
    if done.returncode != 0:
        raise TreeError(f"git {' '.join(arguments)}: {done.stderr.strip()}")
    return done.stdout.strip()


def in_force(intended: list[Intended], root: Path, base: str) -> list[Intended]:
    """The differences of commits that HEAD has and the base lacks. Raises `TreeError` for a commit that HEAD lacks, too."""
    commits = {row.commit for row in intended}
    if strange := sorted(commit for commit in commits if not _is_within(root, commit, "HEAD")):
        raise TreeError(f"{strange[0]}: an intended difference names it, and it is no commit before HEAD")
    held = {commit for commit in commits if not _is_within(root, commit, base)}
    return [row for row in intended if row.commit in held]


def _is_within(root: Path, commit: str, other: str) -> bool:
    """Whether a commit is the other one or one before it; not so for one that is not in the repository."""
    command = ["git", "-C", str(root), "merge-base", "--is-ancestor", commit, other]
    return subprocess.run(command, capture_output=True).returncode == 0


def default_base(root: Path) -> str:
    """Where the branch left main; where it has not, the commit at hand if files differ from it, else the one before."""
    here = git(root, "rev-parse", "HEAD")
    try:
        left = git(root, "merge-base", "HEAD", "main")
    except TreeError:
        left = here
    if left != here:
        return left
    return here if git(root, "status", "--porcelain", "--untracked-files=no") else git(root, "rev-parse", "HEAD~1")


@contextmanager
def worktree(root: Path, commit: str, folder: Path) -> Iterator[Path]:
    """A worktree of a commit with its native library, gone afterwards."""
    git(root, "worktree", "add", "--detach", "--force", str(folder), commit)
    try:
        _provide_library(root, folder)
        yield folder
    finally:
        subprocess.run(["git", "-C", str(root), "worktree", "remove", "--force", str(folder)], capture_output=True)


def _provide_library(root: Path, folder: Path) -> None:
    """Copy the native library of ``root`` where it is built from the same sources, else build it."""
    built = [
        path for path in (root / "unisim_blender").rglob(f"{LIBRARY}.*") if path.suffix in (".so", ".dll", ".dylib")
    ]
    if not built:
        raise TreeError(f"{root}: has no native library; build it with: make setup")
    if _same_sources(root, folder):
        place = re.search(r"LIBRARY DESTINATION (\S+)\)", (folder / "CMakeLists.txt").read_text())
        if place is None:
            raise TreeError(f"{folder / 'CMakeLists.txt'}: does not say where the library is installed")
        shutil.copy2(built[0], folder / place[1])
        return
    build = folder / "build"
    for command in (
        ["cmake", "-S", str(folder), "-B", str(build), "-DCMAKE_BUILD_TYPE=Release"],
        ["cmake", "--build", str(build), "--parallel", str(os.cpu_count() or 1)],
        ["cmake", "--install", str(build), "--prefix", str(folder)],
    ):
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            raise TreeError(f"{' '.join(command)}: {(done.stderr or done.stdout).strip().splitlines()[-1]}")


def _same_sources(a: Path, b: Path) -> bool:
    files = [{path.relative_to(root) for name in NATIVE for path in _sources(root / name)} for root in (a, b)]
    return files[0] == files[1] and all(filecmp.cmp(a / file, b / file, shallow=False) for file in files[0])


def _sources(path: Path) -> list[Path]:
    return [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
