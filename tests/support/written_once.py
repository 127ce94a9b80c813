"""What takes seconds to make and is always the same, made once in a run of the tests by the worker that needs it first.

Files lie in the folder ``UNISIM_TEST_FOLDERS``, which `tests/conftest.py` gives to all workers of a run; without it
everything is made anew.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path

import numpy as np

from unisim_blender.core.geometry import FloatArray

VARIABLE = "UNISIM_TEST_FOLDERS"


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock between processes; a system without `fcntl` has none, and no two workers."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def written_once(out: Path, name: str, write: Callable[[Path], object]) -> Path:
    """Return the folder ``out``, a copy of what ``write`` writes into a folder; ``name`` names all that it depends on."""
    if VARIABLE not in os.environ:
        write(out)
        return out
    folder = Path(os.environ[VARIABLE]) / name
    with _locked(folder.with_suffix(".lock")):
        if not folder.exists():
            partial = folder.with_suffix(".partial")
            shutil.rmtree(partial, ignore_errors=True)
            write(partial)
            partial.rename(folder)
    # with the times of new files: caches ask how old a file is
    shutil.copytree(folder, out, copy_function=shutil.copyfile, dirs_exist_ok=True)
    return out


def computed_once(compute: Callable[[], FloatArray], *inputs: bytes) -> FloatArray:
    """Return what ``compute`` gives, an array that follows from ``inputs`` alone."""
    if VARIABLE not in os.environ:
        return compute()
    digest = sha256(b"".join(sha256(part).digest() for part in inputs)).hexdigest()
    file = Path(os.environ[VARIABLE]) / f"{digest}.npy"
    if not file.exists():
        partial = file.with_suffix(f".{os.getpid()}.npy")
        np.save(partial, compute())
        partial.replace(file)
    values: FloatArray = np.load(file)
    return values
