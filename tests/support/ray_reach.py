"""A program that starts a Ray as `unisim batch --on ray` does, and prints who can reach it, as JSON. It is run in a network
of its own: all that listens there is counted."""

from __future__ import annotations

import json
import os
import socket
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

from unisim_blender.core.executors import EXECUTORS

LISTENING = "0A"
"""The state of a socket in the kernel's table."""
JOIN = "import sys, ray; ray.init(sys.argv[1], log_to_driver=False); print('joined')"
ANSWER_S = 120


class Reach:
    """Makes a function that returns the addresses of all sockets that listen, and the address of the worker's cluster."""

    def __call__(self) -> Callable[[int], dict[str, Any]]:
        return self.reach

    def reach(self, _: int) -> dict[str, Any]:
        import ray

        return {"listening": listening(), "address": ray.get_runtime_context().gcs_address}


def listening() -> list[str]:
    """Return the addresses and ports of all sockets of this network that listen, sorted."""
    found = []
    for table, family, words in (("tcp", socket.AF_INET, 1), ("tcp6", socket.AF_INET6, 4)):
        for line in Path("/proc/net", table).read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == LISTENING:
                host, port = fields[1].split(":")
                packed = struct.pack(f"={words}I", *(int(host[8 * i : 8 * i + 8], 16) for i in range(words)))
                found.append(f"{socket.inet_ntop(family, packed)} {int(port, 16)}")
    return sorted(found)


def joins(address: str, **variables: str) -> bool:
    """Return whether a program of another user, whose home is empty, joins the cluster at an address."""
    from ray._private.ray_constants import ENABLE_RAY_CLUSTERS_ENV_VAR

    kept = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
    with tempfile.TemporaryDirectory() as home:
        own = {"HOME": home, "RAY_USAGE_STATS_ENABLED": "0", ENABLE_RAY_CLUSTERS_ENV_VAR: "0"}  # it looks on loopback
        environment = kept | own | variables
        try:
            done = subprocess.run(
                [sys.executable, "-c", JOIN, address], env=environment, capture_output=True, text=True, timeout=ANSWER_S
            )
        except subprocess.TimeoutExpired:
            return False
    return done.stdout.strip() == "joined"


def main() -> None:
    """Print what listens, and which tokens the cluster is joined with."""
    with closing(EXECUTORS["ray"].run(Reach(), range(1), 1)) as outcomes:
        found: Any = next(outcomes).get()
        token = os.environ["RAY_AUTH_TOKEN"]
        others = {
            "its token": {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": token},
            "another token": {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": "0" * len(token)},
            "no token": {"RAY_AUTH_MODE": "disabled"},
        }
        with ThreadPoolExecutor() as pool:
            asked = {name: pool.submit(joins, found["address"], **variables) for name, variables in others.items()}
        found["joined"] = {name: one.result() for name, one in asked.items()}
        found["homes"] = sorted(path.name for path in Path.home().rglob("*") if path.is_file())
    print(json.dumps(found))


if __name__ == "__main__":
    main()
