"""Where a batch lies: failing requests are repeated, what cannot be mended is one sentence, objects are whole."""

from __future__ import annotations

import hashlib
import pickle
import random
import time
from pathlib import Path
from typing import Any

import fsspec
import pytest
from fsspec.implementations.memory import MemoryFileSystem

from unisim_blender.core.batch.records import Store
from unisim_blender.core.errors import OutputError
from unisim_blender.core.remote.requests import ATTEMPTS

REFUSALS: list[Exception] = []


class Flaky(MemoryFileSystem):  # type: ignore[misc]
    """A store in memory whose next requests fail as `REFUSALS` say."""

    protocol = "flaky"
    store: dict[str, Any] = {}
    pseudo_dirs = [""]

    def pipe_file(self, path: str, value: bytes, *args: Any, **options: Any) -> None:
        if REFUSALS:
            raise REFUSALS.pop(0)
        super().pipe_file(path, value, *args, **options)


@pytest.fixture(autouse=True)
def waits(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    found: list[float] = []
    monkeypatch.setattr(time, "sleep", found.append)
    fsspec.register_implementation("flaky", Flaky, clobber=True)
    REFUSALS.clear()
    return found


def kinds(tmp_path: Path) -> list[Store]:
    return [Store(str(tmp_path / "out")), Store(f"memory://{tmp_path.name}/out")]


def test_objects_are_written_listed_and_removed(tmp_path: Path) -> None:
    for store in kinds(tmp_path):
        assert store.sizes() == {} and store.read("a/b") is None
        store.write("a/b", b"one")
        store.write("a/b", b"three")
        store.write("c", b"")
        again = pickle.loads(pickle.dumps(store))
        assert again.read("a/b") == b"three" and again.sizes() == {"a/b": 5, "c": 0} and again.sizes("a") == {"a/b": 5}
        digest = hashlib.sha256(b"three").hexdigest()
        assert store.holds("a/b", digest, 5, store.sizes()) and not store.holds("a/b", digest, 4, store.sizes())
        store.remove("a/b")
        store.remove("a/b")
        assert store.sizes() == {"c": 0}


def test_a_damaged_file_is_noticed(tmp_path: Path) -> None:
    store = Store(str(tmp_path))
    store.write("a", b"one")
    (tmp_path / "a").write_bytes(b"two")
    assert not store.holds("a", hashlib.sha256(b"one").hexdigest(), 3, store.sizes())


def test_failing_requests_are_repeated_after_longer_waits(waits: list[float]) -> None:
    REFUSALS.extend([ConnectionResetError("reset"), TimeoutError("slow"), OSError("503")])
    random.seed(0)
    Store("flaky://out").write("a", b"one")
    assert Store("flaky://out").read("a") == b"one"
    assert (
        len(waits) == 3 and all(w <= most for w, most in zip(waits, (0.1, 0.2, 0.4), strict=True)) and waits[2] >= 0.2
    )


@pytest.mark.parametrize(
    ("error", "attempts", "sentence"),
    [
        (PermissionError("the token has expired"), 1, "flaky://out/a: cannot be written: the token has expired"),
        (OSError(28, "No space left on device"), 1, "cannot be written: .*No space left"),
        (ConnectionResetError("reset"), ATTEMPTS, "cannot be written in 6 attempts: reset"),
    ],
)
def test_what_cannot_be_mended_is_one_sentence(
    error: Exception, attempts: int, sentence: str, waits: list[float]
) -> None:
    REFUSALS.extend([error] * 10)
    with pytest.raises(OutputError, match=sentence):
        Store("flaky://out").write("a", b"one")
    assert len(REFUSALS) == 10 - attempts and len(waits) == attempts - 1


def test_a_url_of_no_kind_is_refused() -> None:
    with pytest.raises(OutputError, match="nowhere://x: cannot be opened"):
        Store("nowhere://x").write("a", b"")


def test_of_a_full_disk_nothing_half_written_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store, write = Store(str(tmp_path)), Path.write_bytes
    store.write("a", b"one")

    def full(path: Path, data: bytes) -> int:
        write(path, data[:2])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    for name in ("a", "b/c"):
        with pytest.raises(OutputError, match=f"{name}: cannot be written: No space left on device"):
            store.write(name, b"three")
    assert store.sizes() == {"a": 3} and store.read("a") == b"one"
