"""An S3 server on loopback that holds its objects in memory, and of whose requests some fail.

python -m benchmarks.batch_kills.s3_server --port 5000 --failing 0.05
"""

from __future__ import annotations

import json
import logging
import random
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import click

COUNTS = "/unisim-counts"
"""A request for it is answered with the counts of requests, and never fails."""
BUCKET = "kills"


@dataclass
class Failing:
    """In front of an S3 server: of a ``share`` of the requests a third each is refused with 503 and with 500, and has
    its connection closed in the middle of the answer, after the server did what was asked."""

    app: Any
    share: float
    chance: random.Random = field(default_factory=random.Random)
    asked: int = 0
    failed: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __call__(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        """Answer a request of WSGI."""
        if environ["PATH_INFO"] == COUNTS:
            start_response("200 OK", [("Content-Type", "application/json")])
            return [json.dumps({"requests": self.asked, "failed": self.failed}).encode()]
        with self._lock:
            self.asked += 1
            fails = self.chance.random() < self.share
            self.failed += fails
            kind = self.chance.randrange(3)
        if fails and kind < 2:
            length = int(environ.get("CONTENT_LENGTH") or 0)
            environ["wsgi.input"].read(length)  # a client that still sends would see a broken pipe
            status, code = [("503 Slow Down", "SlowDown"), ("500 Internal Server Error", "InternalError")][kind]
            start_response(status, [("Content-Type", "application/xml")])
            return [] if environ["REQUEST_METHOD"] == "HEAD" else [f"<Error><Code>{code}</Code></Error>".encode()]
        answer: Iterable[bytes] = self.app(environ, start_response)
        return _cut(b"".join(answer)) if fails else answer


def _cut(answer: bytes) -> Iterator[bytes]:
    yield answer[: len(answer) // 2]
    raise ConnectionResetError("closed on purpose")


@click.command()
@click.option("--port", type=int, required=True)
@click.option("--failing", type=float, default=0.0, show_default=True, help="Share of the requests that fail.")
@click.option("--seed", type=int, default=0, show_default=True)
def main(port: int, failing: float, seed: int) -> None:
    """Serve S3 on loopback until it is ended."""
    from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
    from werkzeug.serving import make_server

    logging.getLogger("werkzeug").setLevel(logging.CRITICAL)
    app = Failing(DomainDispatcherApplication(create_backend_app), failing, random.Random(seed))
    make_server("127.0.0.1", port, app, threaded=True).serve_forever()


if __name__ == "__main__":
    main()
