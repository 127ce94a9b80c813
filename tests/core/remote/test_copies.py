"""Copies of inputs at URLs: fetched once, whole or not at all, and what changed is fetched again."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
import threading
import time
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import fsspec
import pytest
from fsspec.implementations.memory import MemoryFileSystem

from unisim_blender.core.remote.copies import FolderPart, InputError, MissingInput, copies_used, local_path
from unisim_blender.core.remote.requests import beside, is_url, last_part

FETCHED: list[str] = []
REFUSALS: list[Exception | int] = []


class Counting(MemoryFileSystem):  # type: ignore[misc]
    """A store in memory that notes what is fetched; the next fetches fail, or end after so many bytes, as `REFUSALS` say."""

    protocol = "counting"
    store: dict[str, Any] = {}
    pseudo_dirs = [""]

    @classmethod
    def _strip_protocol(cls, path: str) -> str:
        return str(super()._strip_protocol(path.replace("counting://", "memory://")))

    def get_file(self, rpath: str, lpath: str, *args: Any, **options: Any) -> None:
        FETCHED.append(rpath.rsplit("/", 1)[-1])
        refusal = REFUSALS.pop(0) if REFUSALS else None
        if isinstance(refusal, Exception):
            raise refusal
        super().get_file(rpath, lpath, *args, **options)
        if isinstance(refusal, int):
            Path(lpath).write_bytes(Path(lpath).read_bytes()[:refusal])


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    fsspec.register_implementation("counting", Counting, clobber=True)
    Counting.store.clear()
    FETCHED.clear()
    REFUSALS.clear()
    return tmp_path / "cache" / "inputs"


def put(**files: bytes) -> str:
    for name, data in files.items():
        fsspec.filesystem("counting").pipe_file(f"/logs/street/{name.replace('__', '/')}", data)
    return "counting://logs/street"


def content(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


FILES = {"a": b"one", "lidar__b": b"three", "lidar__c": b""}
THERE = {"a": b"one", "lidar/b": b"three", "lidar/c": b""}


def test_a_folder_is_fetched_once(cache: Path) -> None:
    url = put(**FILES)
    path = local_path(url)
    assert content(path) == THERE and path.name == "street"
    assert local_path(url) == path == local_path(f"{url}/") and sorted(FETCHED) == ["a", "b", "c"]
    assert sorted(one.name for one in cache.iterdir()) == ["copies", "held", "known", "lock", "used"]
    one = local_path(f"{url}/a")
    assert one.read_bytes() == b"one" and one.name == "a"


def test_what_changed_is_fetched_again_and_equal_content_is_one_copy() -> None:
    url = put(**FILES)
    before = local_path(url)
    put(a=b"two")
    after = local_path(url)
    assert after != before and content(after) == {**THERE, "a": b"two"} and content(before) == THERE
    put(a=b"one")
    assert local_path(url) == before


def test_a_damaged_copy_is_replaced() -> None:
    url = put(**FILES)
    path = local_path(url)
    (path / "lidar" / "b").write_bytes(b"thr")
    assert local_path(url) == path and content(path) == THERE
    (path / "a").unlink()
    assert local_path(url) == path and content(path) == THERE


def test_failing_and_broken_fetches_are_repeated() -> None:
    url = put(**FILES)
    REFUSALS.extend([ConnectionResetError("reset"), 1, TimeoutError("slow"), 2])
    assert content(local_path(url)) == THERE


@pytest.mark.parametrize(
    ("refusal", "sentence"),
    [
        (
            PermissionError("the token has expired"),
            "counting://logs/street/a: cannot be fetched: the token has expired",
        ),
        (ConnectionResetError("reset"), "cannot be fetched in 6 attempts: reset"),
        (2, "cannot be fetched in 6 attempts: 2 of 3 bytes came"),
        (OSError(28, "No space left on device"), "cannot be fetched: .*No space left"),
    ],
)
def test_a_partial_copy_is_never_used(refusal: Exception | int, sentence: str, cache: Path) -> None:
    url = put(a=b"one")
    REFUSALS.extend([refusal] * 20)
    with pytest.raises(InputError, match=sentence):
        local_path(url)
    assert list((cache / "copies").iterdir()) == [] and list(cache.glob(".*")) == [] and not list(cache.rglob("*.json"))
    REFUSALS.clear()
    assert content(local_path(url)) == {"a": b"one"}


def test_what_is_written_while_it_is_fetched_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    url = put(**FILES)
    get = Counting.get_file

    def write_and_get(self: Any, rpath: str, lpath: str, **options: Any) -> None:
        put(a=b"new")
        get(self, rpath, lpath, **options)

    monkeypatch.setattr(Counting, "get_file", write_and_get)
    with pytest.raises(InputError, match=r"street: was written while|cannot be fetched in 6 attempts: . of"):
        local_path(url)


def test_what_a_killed_process_left_is_removed(cache: Path) -> None:
    url = put(**FILES)
    path = local_path(url)
    (lock,) = (cache / "known").glob("*.lock")
    lock.with_suffix(".json").unlink()
    left = cache / f".fetching-{lock.stem[:16]}-left"
    (left / "street").mkdir(parents=True)
    assert local_path(url) == path and not left.exists()


def test_nothing_at_a_url_and_no_such_store() -> None:
    with pytest.raises(MissingInput, match="counting://logs/none: there is nothing there"):
        local_path("counting://logs/none")
    with pytest.raises(InputError, match="nowhere://x: cannot be opened"):
        local_path("nowhere://x")


def test_a_part_leaves_empty_space_for_the_rest() -> None:
    url = put(**FILES)
    part = FolderPart("some", lambda sizes: {"a"} | {name for name in sizes if sizes[name] == 0})
    path = local_path(url, part)
    assert content(path) == {"a": b"one", "lidar/b": bytes(5), "lidar/c": b""} and "b" not in FETCHED
    assert content(local_path(url)) == THERE
    with copies_used() as used:
        whole = local_path(url)
        assert local_path(url, part) == whole, "the whole is there already"
    assert list(used) == [(url, "")]


def test_known_copies_hold_whatever_is_written_meanwhile() -> None:
    url = put(**FILES)
    with copies_used() as used:
        before = local_path(url)
    copies = pickle.loads(pickle.dumps(tuple(used.values())))
    with copies_used(copies):
        put(a=b"two")
        assert local_path(url) == before
    before.rename(before.with_name("gone"))  # another machine has none yet
    with pytest.raises(InputError, match="street: is not what it was when the batch was planned"), copies_used(copies):
        pass
    put(a=b"one")
    with copies_used(copies):
        assert content(local_path(url)) == THERE


def test_two_processes_fetch_the_same_at_once(tmp_path: Path, cache: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    for number in range(20):
        (source / f"{number:02d}").write_bytes(bytes([number]) * 20_000)
    code = (
        "import sys; from unisim_blender.core.remote.copies import local_path\n"
        f"print(local_path('file://{source.as_posix()}'))"
    )
    quiet: dict[str, Any] = {"stdout": subprocess.PIPE, "text": True}
    both = [subprocess.Popen([sys.executable, "-c", code], **quiet) for _ in range(2)]
    paths = {Path(one.communicate()[0].strip()) for one in both}
    assert len(paths) == 1 and content(paths.pop()) == content(source)
    assert len(list((cache / "copies").iterdir())) == 1
    (known,) = (cache / "known").glob("*.json")
    assert len(json.loads(known.read_bytes())["sizes"]) == 20


def test_names_relative_to_urls() -> None:
    base = "s3://bucket/sweeps/base.json"
    assert beside(base, "street") == "s3://bucket/sweeps/street"
    assert beside(base, "../logs/a/") == "s3://bucket/logs/a"
    assert beside(base, "../../../a") == "s3://bucket/a", "nothing lies above a bucket"
    assert beside(base, "gs://other/a") == "gs://other/a" and beside(base, "/data/a") == "/data/a"
    assert beside("file:///data/base.json", "street") == "file:///data/street"
    assert [is_url(name) for name in ("s3://a", "C:\\a", "C:/a", "a/b", Path("s3://a"))] == [True, *[False] * 4]
    assert last_part("s3://a/b/") == "b"


def test_a_file_over_http_is_fetched_while_its_version_is_the_same(tmp_path: Path) -> None:
    pytest.importorskip("aiohttp", reason="fsspec needs it for http")
    (tmp_path / "base.json").write_bytes(b"{}")
    asked: list[str] = []

    class Handler(SimpleHTTPRequestHandler):
        def log_request(self, code: Any = "-", size: Any = "-") -> None:
            asked.append(f"{self.command} {self.path}")

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(tmp_path)))
    threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
    try:
        url = f"http://127.0.0.1:{server.server_port}"
        path = local_path(f"{url}/base.json")
        assert path.read_bytes() == b"{}" and path.name == "base.json"
        fetched = asked.count("GET /base.json")
        assert local_path(f"{url}/base.json") == path
        assert asked.count("GET /base.json") == fetched
        with pytest.raises(MissingInput, match=f"{url}/none.json: there is nothing there"):
            local_path(f"{url}/none.json")
    finally:
        server.shutdown()
