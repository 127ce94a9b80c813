"""A Ray that is started for a batch is closed to others: it listens on loopback alone, and asks for a token."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import ray_reach

pytest.importorskip("ray")
pytestmark = pytest.mark.slow  # a Ray and three programs that ask to join it

NETWORK = """
ip link set lo up && ip link add v0 type veth peer name v1 && ip link set v1 up && ip link set v0 up &&
ip addr add 10.9.7.7/24 dev v0 && ip route add default via 10.9.7.8
"""
"""Beside loopback an address that others would reach, which Ray takes as the machine's unless it is told another one."""


def in_network(*command: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a command in a network of its own."""
    words = ["unshare", "--net", "sh", "-c", f'{NETWORK.strip()} && exec "$@"', "sh", *command]
    return subprocess.run(words, env=os.environ | variables, capture_output=True, text=True)


@pytest.fixture
def network() -> None:
    try:
        done = in_network("true")
    except OSError as error:
        pytest.skip(f"there are no network namespaces: {error}")
    if done.returncode:
        pytest.skip(f"a network namespace cannot be made: {done.stderr.strip()}")


def test_a_ray_of_this_machine_is_closed_to_others(
    network: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    # workers find the program's module there
    done = in_network(
        sys.executable, "-m", "ray_reach", HOME=str(tmp_path), PYTHONPATH=str(Path(ray_reach.__file__).parent)
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    hosts = {one.split()[0].removeprefix("::ffff:") for one in found["listening"]}
    assert len(found["listening"]) >= 3 and hosts == {"127.0.0.1"}, found["listening"]
    assert not [one for one in found["listening"] if one.endswith(" 8265")], "the dashboard is off"
    assert found["joined"] == {"its token": True, "another token": False, "no token": False}
    assert found["homes"] == [], "nothing is written into the user's home"
