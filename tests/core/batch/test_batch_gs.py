"""A batch's store and its inputs in Google's storage: an emulator of it on loopback."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from small_batch import batch, files, write_batch

from unisim_blender.core.batch.records import Store

server = pytest.importorskip("gcp_storage_emulator.server", reason="no emulator is installed: make test-gs")

OPTIONS = ("--sensors", "front_camera")


@pytest.fixture(scope="module")
def bucket() -> Iterator[str]:
    """The URL of a bucket."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    emulator = server.create_server("127.0.0.1", port, in_memory=True, default_bucket="batches")
    emulator.start()
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {
            "STORAGE_EMULATOR_HOST": f"http://127.0.0.1:{port}", "NO_GCE_CHECK": "true",
            "GCSFS_EXPERIMENTAL_ZB_HNS_SUPPORT": "false",  # it would ask Google what kind of bucket it is
        }.items():  # fmt: skip
            patch.setenv(name, value)
        pytest.importorskip("gcsfs", reason="gcsfs is not installed: make test-gs")
        yield "gs://batches"
    emulator.stop()


def test_objects_are_written_listed_and_removed(bucket: str) -> None:
    store = Store(f"{bucket}/one")
    assert store.sizes() == {} and store.read("a/b") is None
    store.write("a/b", b"one")
    store.write("a/b", b"three")
    store.write("c", b"")
    assert store.read("a/b") == b"three" and store.sizes() == {"a/b": 5, "c": 0} and store.sizes("a") == {"a/b": 5}
    assert store.times().keys() == {"a/b", "c"} and all(time_s > 1e9 for time_s in store.times().values())
    store.remove("c")
    store.remove("c")
    assert store.sizes() == {"a/b": 5}


def test_a_batch_of_a_log_there_stores_what_a_folder_holds(bucket: str, small_street: Path, tmp_path: Path) -> None:
    folder = write_batch(tmp_path, small_street, f"{bucket}/street", formats=["png", "labels"])
    for name, data in files(folder / "street").items():
        Store(f"{bucket}/street").write(name, data)
    assert batch(folder / "sweep.json", folder / "whole", *OPTIONS) == 0
    store = Store(f"{bucket}/batch")
    assert batch(folder / "sweep.json", store.url, *OPTIONS) == 0
    whole = {name: data for name, data in files(folder / "whole").items() if name != "report.html"}
    assert {name: store.read(name) for name in store.sizes() if name != "report.html"} == whole
    store.remove("records/000001.json")
    store.remove("manifest.json")
    assert batch(folder / "sweep.json", store.url, *OPTIONS, "--resume") == 0
    assert {name: store.read(name) for name in store.sizes() if name != "report.html"} == whole
