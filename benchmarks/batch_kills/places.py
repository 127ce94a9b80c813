"""Where batches are written: folders, or an S3 server that is started for them."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.request import urlopen

from unisim_blender.core.batch.records import Store
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.remote.requests import file_system, tried

from .processes import end
from .s3_server import BUCKET, COUNTS
from .sweep import LOG, SCENE

S3_PORT = 5000
ENDPOINT = f"http://127.0.0.1:{S3_PORT}"
VARIABLES = {
    "AWS_ENDPOINT_URL": ENDPOINT, "AWS_ACCESS_KEY_ID": "none", "AWS_SECRET_ACCESS_KEY": "none",
    "AWS_DEFAULT_REGION": "us-east-1", "AWS_CONFIG_FILE": "/dev/null", "AWS_SHARED_CREDENTIALS_FILE": "/dev/null",
}  # fmt: skip
"""Of all processes that use the server."""
S3_LOG, S3_SCENE, S3_OUT = (f"s3://{BUCKET}/{name}" for name in ("street", "scene", "batch"))


def digests(store: Store) -> dict[str, str]:
    """Return the SHA-256 of all objects of a store, by their names."""
    return {name: hashlib.sha256(store.read(name) or b"").hexdigest() for name in sorted(store.sizes())}


@contextmanager
def s3_server(folder: Path, failing: float, seed: int) -> Iterator[subprocess.Popen[bytes]]:
    """Serve S3 with the street's log and scene in it, where this share of the requests fails, and end the server.
    `VARIABLES` are set."""
    command = [sys.executable, "-m", "benchmarks.batch_kills.s3_server", "--port", str(S3_PORT)]
    with (folder / "s3.log").open("wb") as log:
        process = subprocess.Popen(
            [*command, "--failing", str(failing), "--seed", str(seed)], stdout=log, stderr=log, start_new_session=True
        )
    try:
        while process.poll() is None:
            try:
                requests()
                break
            except OSError:
                time.sleep(0.1)
        fs, _ = file_system(f"s3://{BUCKET}", UnisimError)
        tried(lambda: fs.exists(BUCKET) or fs.mkdir(BUCKET), f"{BUCKET}: cannot be made", UnisimError)
        for place, url in ((LOG, S3_LOG), (SCENE, S3_SCENE)):
            store = Store(url)
            for path in sorted(place.rglob("*")):
                if path.is_file():
                    store.write(path.relative_to(place).as_posix(), path.read_bytes())
        yield process
    finally:
        end(process)


def requests() -> dict[str, int]:
    """Return how many requests the server was asked, and how many of them it had fail."""
    with urlopen(f"{ENDPOINT}{COUNTS}", timeout=30) as answer:
        counts: dict[str, int] = json.loads(answer.read())
    return counts
