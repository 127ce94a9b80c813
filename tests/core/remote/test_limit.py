"""The limit of the copies of inputs: the oldest go first, and what a process uses stays."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.remote.copies import copies_used, local_path
from unisim_blender.core.remote.limit import (
    HAS_LOCKS,
    LIMIT_GB,
    VARIABLE,
    cache_sizes,
    clear_cache,
    limit_bytes,
    make_room,
)

pytest.importorskip("fsspec")
pytestmark = pytest.mark.skipif(not HAS_LOCKS, reason="without locks of files nothing is removed")

SIZE = 20_000
FETCH = (
    "import sys; from unisim_blender.core.remote.copies import local_path; print(local_path(sys.argv[1]), flush=True)"
)


@pytest.fixture
def inputs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the copies, of which three have room."""
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv(VARIABLE, str(3.5 * SIZE / 1e9))
    return tmp_path / "cache" / "inputs"


@pytest.fixture
def source(tmp_path: Path) -> Callable[[int], str]:
    """Writes the folder of a number; its URL."""

    def write(number: int) -> str:
        folder = tmp_path / "source" / f"log{number}"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "a").write_bytes(bytes([number]) * SIZE)
        return f"file://{folder.as_posix()}"

    return write


def fetched_elsewhere(url: str) -> Path:
    """Fetch in a process that ends; the copy's path."""
    return Path(
        subprocess.run([sys.executable, "-c", FETCH, url], check=True, capture_output=True, text=True).stdout[:-1]
    )


@pytest.fixture
def other(source: Callable[[int], str]) -> Iterator[Path]:
    """A copy that another process uses, which waits."""
    code = f"{FETCH}; sys.stdin.read()"
    process = subprocess.Popen(
        [sys.executable, "-c", code, source(9)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    yield Path(process.stdout.readline().strip())
    process.communicate("")


def age(inputs: Path, path: Path, seconds: float) -> None:
    """Have a copy be used last at a time."""
    (marker,) = (inputs / "used").glob(f"{path.parent.name}.*")
    assert marker.suffix == f".{SIZE}"
    os.utime(marker, (seconds, seconds))


def test_the_oldest_go_and_what_processes_use_stays(inputs: Path, source: Callable[[int], str], other: Path) -> None:
    paths = [fetched_elsewhere(source(number)) for number in range(2)]
    age(inputs, other, 1.0)
    age(inputs, paths[1], 2.0)
    age(inputs, paths[0], 3.0)
    mine = local_path(source(2))
    assert [path.exists() for path in (other, paths[1], paths[0], mine)] == [True, False, True, True]
    assert len(list((inputs / "known").glob("*.json"))) == 3, "what is known of the removed one is gone"
    age(inputs, mine, 0.5)
    with copies_used() as used:
        again = local_path(source(1))
    assert again == paths[1] and (again / "a").read_bytes() == bytes([1]) * SIZE, "fetched again"
    assert [path.exists() for path in (other, paths[0], mine)] == [True, False, True], "both are in use"
    with copies_used(used.values()):
        more = [local_path(source(number)) for number in (3, 4)]
    assert all(path.exists() for path in (other, mine, again, *more)), "all in use, beyond the limit"
    assert not list(inputs.glob(".dropped-*")) and not list(inputs.glob(".fetching-*"))


def test_copies_of_processes_that_ended_are_not_held(inputs: Path, source: Callable[[int], str]) -> None:
    path = fetched_elsewhere(source(0))
    assert path.exists() and len(list((inputs / "held").iterdir())) == 1
    (inputs / ".dropped-by-a-killed-process").mkdir()
    for marker in (inputs / "used").iterdir():
        marker.unlink()  # as of a copy that an earlier version made
    make_room(inputs, round(2.4 * SIZE))
    assert path.exists() and not list(inputs.glob(".dropped-*"))
    make_room(inputs, round(2.6 * SIZE))
    assert not path.exists() and not list((inputs / "held").iterdir()) and not list((inputs / "used").iterdir())


def test_caches_are_measured_and_cleared_but_for_what_is_in_use(
    inputs: Path, source: Callable[[int], str], other: Path
) -> None:
    unused = fetched_elsewhere(source(0))
    surfels, digest = inputs.parent / "surfels", 16 * "0a"
    for name in (f"{digest}/points.npy", f".{digest}-1/points.npy", "night/weights.safetensors"):
        (surfels / name).parent.mkdir(parents=True)
        (surfels / name).write_bytes(b"1" * SIZE)
    (surfels / f"{digest}.npz").write_bytes(b"1")
    assert cache_sizes()["surfels"] == 2 * SIZE + 1 and 2 * SIZE <= cache_sizes()["inputs"] < 3 * SIZE
    clear_cache()
    left = sorted(path.name for path in surfels.iterdir())
    assert left == [f".{digest}-1", "night"], "one is being written, the other is no cache's"
    assert other.exists() and not unused.exists()


def test_a_cache_that_was_emptied_is_filled_again(inputs: Path, source: Callable[[int], str]) -> None:
    import shutil

    local_path(source(0))
    shutil.rmtree(inputs)
    path = local_path(source(0))
    make_room(inputs, 10 * SIZE)
    assert path.exists(), "it is held"


def test_the_limit_is_a_size(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    assert limit_bytes() == LIMIT_GB * 1e9
    monkeypatch.setenv(VARIABLE, "inf")
    assert limit_bytes() == float("inf")
    for wrong in ("-1", "nan", "10 GB"):
        monkeypatch.setenv(VARIABLE, wrong)
        with pytest.raises(UnisimError, match=f"UNISIM_INPUTS_GB: '{wrong}' is no size in GB"):
            limit_bytes()
