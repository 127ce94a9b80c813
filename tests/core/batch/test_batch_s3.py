"""A batch's store in S3: moto's server on loopback, with requests that fail."""

from __future__ import annotations

import json
import logging
import os
import random
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import small_batch
from small_batch import batch, files, write_batch

from unisim_blender.core.batch.records import Store
from unisim_blender.core.cli.main import run
from unisim_blender.core.errors import OutputError
from unisim_blender.core.files import cache_folder
from unisim_blender.core.remote.copies import InputError, local_path

boto3 = pytest.importorskip("boto3")
s3fs = pytest.importorskip("s3fs")
moto_app = pytest.importorskip("moto.moto_server.werkzeug_app")
serving = pytest.importorskip("werkzeug.serving")

OPTIONS = ("--sensors", "front_camera")


@dataclass
class Faults:
    """In front of an S3 server: refuses every ``every``-th request with 503, or all with an expired token, from the first object
    on that is written with ``expires_with`` in its name, or ends the connection in the middle of so many answers."""

    app: Any
    every: int = 0
    expired: bool = False
    expires_with: str = ""
    dropped: int = 0
    refused: int = 0
    asked: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __call__(self, environ: dict[str, Any], start_response: Any) -> Any:
        with self._lock:
            self.asked += 1
            if self.expired:
                return self._refuse(environ, start_response, "400 Bad Request", "ExpiredToken")
            if self.every and self.asked % self.every == 0:
                self.refused += 1
                return self._refuse(environ, start_response, "503 Service Unavailable", "ServiceUnavailable")
            if self.expires_with and environ["REQUEST_METHOD"] == "PUT":
                self.expired = self.expires_with in environ["PATH_INFO"]  # this one is still written
            dropped, self.dropped = self.dropped > 0, max(0, self.dropped - 1)
        answer = self.app(environ, start_response)
        return _cut(b"".join(answer)) if dropped else answer

    def _refuse(self, environ: dict[str, Any], start_response: Any, status: str, code: str) -> list[bytes]:
        start_response(status, [("Content-Type", "application/xml")])
        if environ["REQUEST_METHOD"] == "HEAD":
            return []
        return [f"<Error><Code>{code}</Code><Message>told by the test</Message></Error>".encode()]


def _cut(answer: bytes) -> Iterator[bytes]:
    yield answer[: len(answer) // 2]
    raise ConnectionResetError("ended by the test")


@pytest.fixture(scope="module")
def server() -> Iterator[Faults]:
    faults = Faults(moto_app.DomainDispatcherApplication(moto_app.create_backend_app))
    server = serving.make_server("127.0.0.1", 0, faults, threaded=True)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{server.server_port}",
            "AWS_ACCESS_KEY_ID": "none", "AWS_SECRET_ACCESS_KEY": "none", "AWS_DEFAULT_REGION": "us-east-1",
            "AWS_MAX_ATTEMPTS": "1", "AWS_CONFIG_FILE": "/dev/null", "AWS_SHARED_CREDENTIALS_FILE": "/dev/null",
        }.items():  # fmt: skip
            patch.setenv(name, value)
        s3fs.S3FileSystem.clear_instance_cache()  # they keep the address of another test's server
        patch.setattr("s3fs.core.S3FileSystem.retries", 1)  # ours are tested
        patch.setattr("unisim_blender.core.remote.requests.FIRST_WAIT_S", 0.01)
        boto3.client("s3").create_bucket(Bucket="batches")
        yield faults
    server.shutdown()


@pytest.fixture
def faults(server: Faults) -> Iterator[Faults]:
    yield server
    server.every = server.dropped = server.refused = server.asked = 0
    server.expired, server.expires_with = False, ""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, small_street: Path, server: Faults) -> Path:
    """A sweep whose log lies in the store."""
    folder = write_batch(
        tmp_path_factory.mktemp("s3"), small_street, "s3://batches/logs/street", formats=["png", "labels"]
    )
    s3fs.S3FileSystem().put(f"{folder.as_posix()}/street/", "batches/logs/street/", recursive=True)
    return folder


@pytest.fixture(scope="module")
def whole(folder: Path) -> dict[str, bytes]:
    """What the sweep makes in a folder."""
    assert batch(folder / "sweep.json", folder / "whole", *OPTIONS) == 0
    return without_report(files(folder / "whole"))


def without_report(found: dict[str, bytes]) -> dict[str, bytes]:
    """All files but the page, which names places of the batch by its folder or its URL."""
    assert "report.html" in found
    return {name: data for name, data in found.items() if name != "report.html"}


def stored(prefix: str) -> dict[str, bytes]:
    client = boto3.client("s3")
    found = client.list_objects_v2(Bucket="batches", Prefix=f"{prefix}/").get("Contents", [])
    return {
        one["Key"].removeprefix(f"{prefix}/"): client.get_object(Bucket="batches", Key=one["Key"])["Body"].read()
        for one in found
    }


def test_objects_are_there_whole_though_requests_fail(faults: Faults) -> None:
    store = Store("s3://batches/one")
    assert store.sizes() == {} and store.read("records/0.json") is None
    faults.every = 4
    objects = {f"captures/{number:02d}": bytes([number]) * number for number in range(12)}
    for name, data in objects.items():
        store.write(name, data)
    assert faults.refused >= 3
    assert store.sizes() == {name: len(data) for name, data in objects.items()}
    assert {name: store.read(name) for name in objects} == objects
    assert store.sizes("captures") == store.sizes()
    store.remove("captures/03")
    assert "captures/03" not in store.sizes()


def test_of_two_writers_of_one_object_one_is_whole(faults: Faults) -> None:
    written = [bytes([number]) * 200_000 for number in range(2)]
    writers = [threading.Thread(target=Store("s3://batches/both").write, args=("a", data)) for data in written]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert Store("s3://batches/both").read("a") in written


def test_a_lost_connection_is_tried_again(faults: Faults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store, data = Store("s3://batches/lost"), random.Random(0).randbytes(100_000)
    faults.dropped = 2
    store.write("a", data)
    faults.dropped = 2
    assert store.read("a") == data
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path))
    faults.dropped = 3
    assert local_path("s3://batches/lost/a").read_bytes() == data
    assert faults.dropped == 0


def test_an_expired_credential_is_one_sentence(faults: Faults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store("s3://batches/two")
    store.write("a", b"one")
    faults.expired, faults.asked = True, 0
    with pytest.raises(OutputError, match=r"^s3://batches/two/a: cannot be written: [^\n]*$"):
        store.write("a", b"two")
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path))
    with pytest.raises(InputError, match=r"^s3://batches/two/a: cannot be listed: [^\n]*$"):
        local_path("s3://batches/two/a")
    assert faults.asked <= 4, "another attempt does not mend it"
    faults.expired = False
    assert store.read("a") == b"one" and not list(tmp_path.rglob("a"))


def test_a_credential_that_expires_halfway_ends_the_batch_with_a_sentence(
    faults: Faults, folder: Path, whole: dict[str, bytes], capsys: pytest.CaptureFixture[str]
) -> None:
    faults.expires_with = "/records/"
    assert batch(folder / "sweep.json", "s3://batches/expired", *OPTIONS) == 1
    (fault,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("Error: ")]
    assert fault.startswith("Error: s3://batches/expired/") and "cannot be written" in fault
    faults.expired, faults.expires_with = False, ""
    there = stored("expired")
    assert [name for name in there if name.startswith("records/")] == ["records/000000.json"]
    assert there.items() <= whole.items(), "what is there is whole"
    assert run(["batch", "status", "s3://batches/expired", "--json"]) == 0
    status = json.loads(capsys.readouterr().out)
    assert (status["units"], status["finished"], status["manifest"]) == (4, 1, False)
    assert 0 <= status["seconds_since_last"] < 600
    assert batch(folder / "sweep.json", "s3://batches/expired", *OPTIONS, "--resume") == 0
    assert without_report(stored("expired")) == whole


def test_a_bucket_that_is_not_there_is_one_sentence(faults: Faults) -> None:
    with pytest.raises(OutputError, match="s3://nowhere/a: cannot be written"):
        Store("s3://nowhere").write("a", b"")


def test_a_batch_whose_requests_fail_stores_what_a_folder_holds(
    faults: Faults, folder: Path, whole: dict[str, bytes]
) -> None:
    shutil.rmtree(cache_folder() / "inputs")  # so that the log is fetched, too
    faults.every = 20
    assert batch(folder / "sweep.json", "s3://batches/failing", *OPTIONS) == 0
    assert faults.refused >= 2
    faults.every = 0
    found = stored("failing")
    assert without_report(found) == whole
    assert b"s3://batches/failing/variants/" in found["report.html"]


def test_a_batch_that_was_killed_is_resumed_there(faults: Faults, folder: Path, whole: dict[str, bytes]) -> None:
    code = "import sys; from small_batch import batch; sys.exit(batch(*sys.argv[1:]))"
    arguments = (str(folder / "sweep.json"), "s3://batches/killed", *OPTIONS)
    path = os.pathsep.join([str(Path(small_batch.__file__).parent), os.environ.get("PYTHONPATH", "")])
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(
        [sys.executable, "-c", code, *arguments], env={**os.environ, "PYTHONPATH": path}, **quiet
    )
    store = Store("s3://batches/killed")
    while process.poll() is None and not store.sizes("records"):
        time.sleep(0.01)
    process.kill()
    process.wait()
    assert store.sizes("records") and store.read("manifest.json") is None, "killed halfway"
    faults.every = 20
    assert batch(folder / "sweep.json", "s3://batches/killed", *OPTIONS, "--resume") == 0
    faults.every = 0
    assert without_report(stored("killed")) == whole
