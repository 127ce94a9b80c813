"""A batch's store in S3: moto's server on loopback, with requests that fail."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from unisim_blender.core.batch.store import Store
from unisim_blender.core.errors import OutputError

boto3 = pytest.importorskip("boto3")
pytest.importorskip("s3fs")
moto_app = pytest.importorskip("moto.moto_server.werkzeug_app")
serving = pytest.importorskip("werkzeug.serving")


@dataclass
class Faults:
    """In front of an S3 server: refuses every ``every``-th writing request with 503, or all with an expired token."""

    app: Any
    every: int = 0
    expired: bool = False
    refused: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _count: int = 0

    def __call__(self, environ: dict[str, Any], start_response: Any) -> Any:
        with self._lock:
            writes = environ["REQUEST_METHOD"] == "PUT"
            self._count += writes
            if self.expired:
                return self._refuse(start_response, "400 Bad Request", "ExpiredToken")
            if self.every and writes and self._count % self.every == 0:
                self.refused += 1
                return self._refuse(start_response, "503 Service Unavailable", "ServiceUnavailable")
        return self.app(environ, start_response)

    def _refuse(self, start_response: Any, status: str, code: str) -> list[bytes]:
        start_response(status, [("Content-Type", "application/xml")])
        return [f"<Error><Code>{code}</Code><Message>told by the test</Message></Error>".encode()]


@pytest.fixture
def faults(monkeypatch: pytest.MonkeyPatch) -> Iterator[Faults]:
    faults = Faults(moto_app.DomainDispatcherApplication(moto_app.create_backend_app))
    server = serving.make_server("127.0.0.1", 0, faults, threaded=True)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    for name, value in {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{server.server_port}",
        "AWS_ACCESS_KEY_ID": "none", "AWS_SECRET_ACCESS_KEY": "none", "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_MAX_ATTEMPTS": "1", "AWS_CONFIG_FILE": "/dev/null", "AWS_SHARED_CREDENTIALS_FILE": "/dev/null",
    }.items():  # fmt: skip
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("s3fs.core.S3FileSystem.retries", 1, raising=False)  # ours are tested
    boto3.client("s3").create_bucket(Bucket="batches")
    yield faults
    server.shutdown()


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


def test_an_expired_credential_is_one_sentence(faults: Faults) -> None:
    store = Store("s3://batches/two")
    store.write("a", b"one")
    faults.expired = True
    with pytest.raises(OutputError, match=r"^s3://batches/two/a: cannot be written: .*[^\n]*$"):
        store.write("a", b"two")
    faults.expired = False
    assert store.read("a") == b"one"


def test_a_bucket_that_is_not_there_is_one_sentence(faults: Faults) -> None:
    with pytest.raises(OutputError, match="s3://nowhere/a: cannot be written"):
        Store("s3://nowhere").write("a", b"")
