"""Units of work on a Ray cluster, or on a Ray of this machine that is started for them."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from typing import Any

from ..errors import UnisimError, in_a_line
from ..native import VARIANT_VARIABLE, library, variant
from ..processes import THREAD_VARIABLES
from .dispatch import PREPARING, dispatch, scene_of_each_unit
from .executor import MakeFunction, OnWorker, Outcome, Outcomes, ProcessLost, ResultT, UnitT, attempt, ignore, register

ADDRESS_PATTERN = re.compile(r"(ray://)?[^\s/:]+:\d+|ray://[^\s/:]+")
"""A cluster: the address of its head, or ``ray://`` and that of the Ray client's server there (port 10001 by default)."""
CLIENT_PORT = 10001
CONNECT_TIMEOUT_S = 10.0
WATCH_INTERVAL_S = 1.0
"""Interval, in seconds, at which Ray's own processes are checked while workers run."""
OBJECT_STORE_BYTES = 200 << 20
"""Memory of a Ray that is started here for units on their way; scenes are not in it."""


@dataclass(frozen=True)
class RayCluster:
    """Runs units in actors of Ray, of one core, one thread and ``gpus`` GPUs each.

    ``address`` names the cluster; None is that of the variable ``RAY_ADDRESS``, or a Ray that is started on this machine
    and ended with the run. ``jobs`` are the actors; None: as many as the cluster has room for as the run starts. Those
    that find no room wait until a node joins. An actor that is lost, alone or with its node, is replaced, and its unit
    run again by whichever actor is free first.

    Raises `UnisimError` where no cluster can be joined, where a node has no unisim_blender, and where a Ray of this machine
    has not the GPUs of one actor.
    """

    address: str | None = None
    gpus: float = 0.0

    @property
    def named(self) -> str | None:
        """The address of the cluster; None where a Ray is started here."""
        return self.address or os.environ.get("RAY_ADDRESS") or None

    def run(
        self,
        make: MakeFunction[UnitT, ResultT],
        units: Sequence[UnitT],
        jobs: int | None = None,
        scenes: Sequence[str] | None = None,
        on_worker: OnWorker = ignore,
    ) -> Outcomes[ResultT]:
        if not units:
            return
        with _joined(self.named, min(jobs or os.cpu_count() or 1, len(units))) as ray:
            most = jobs or _room(ray, self.gpus)
            if self.named is None:
                _check_gpus(ray, self.gpus)
            yield from dispatch(
                _Pool(ray, make, self.gpus), units, most, scene_of_each_unit(scenes, len(units)), on_worker
            )


register("ray", RayCluster())


@contextmanager
def _joined(address: str | None, cores: int) -> Iterator[Any]:
    """Give Ray's module, connected; what is started here is ended here."""
    if address is None:
        # Ray asks for a token where no mode is set, and would write one into the user's home
        own = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": None, "RAY_AUTH_TOKEN": _token()}
        with _environment(own), _socket_folder() as folder, ExitStack() as stack:
            import ray

            stack.enter_context(_loopback_alone())
            given: dict[str, Any] = {
                "address": "local", "num_cpus": cores, "include_dashboard": False, "_node_ip_address": "127.0.0.1",
                "_temp_dir": folder, "object_store_memory": OBJECT_STORE_BYTES,
            }  # fmt: skip
            with _connected(ray, "Ray cannot be started here", given):
                yield ray
        return
    import ray

    if ray.is_initialized():  # a program that uses Ray itself
        yield ray
        return
    _check_answer(address)
    with _connected(ray, f"{address}: cannot be joined as a Ray cluster", {"address": address}):
        yield ray


def _check_answer(address: str) -> None:
    """Raise `UnisimError` where nothing listens at an address: Ray would try for minutes."""
    if not ADDRESS_PATTERN.fullmatch(address):
        return  # "auto": Ray knows where
    host, _, port = address.removeprefix("ray://").partition(":")
    try:
        socket.create_connection((host, int(port or CLIENT_PORT)), CONNECT_TIMEOUT_S).close()
    except (OSError, OverflowError) as error:
        raise UnisimError(f"{address}: no Ray cluster answers there: {in_a_line(error)}") from error


@contextmanager
def _connected(ray: Any, otherwise: str, given: dict[str, Any]) -> Iterator[None]:
    try:
        ray.init(**given, log_to_driver=False, logging_level="error")
    except Exception as error:  # of many kinds: no answer, another version, no token, no room
        with suppress(Exception):
            ray.shutdown()
        raise UnisimError(f"{otherwise}: {in_a_line(error)}") from error
    try:
        with _explaining_raylet_loss(ray):
            yield
    finally:
        ray.shutdown()


WATCHER_SCRIPT = """
import socket, sys
if not sys.stdin.buffer.read():
    with socket.socket(socket.AF_UNIX) as raylet:
        if raylet.connect_ex(sys.argv[1]):
            print("Error:", sys.argv[2], file=sys.stderr, flush=True)
"""


@contextmanager
def _explaining_raylet_loss(ray: Any) -> Iterator[None]:
    """Have a process beside this one say why it ended where its raylet is lost: Ray then ends this process at once, exit code 1,
    in the middle of its own code, and says nothing."""
    node = ray._private.worker.global_worker.node
    if node is None or not hasattr(socket, "AF_UNIX"):
        yield
        return
    path = node.raylet_socket_name.removeprefix("unix://")
    message = "Ray's raylet was ended from outside (out of memory?), and Ray this process; continue with --resume"
    command = [sys.executable, "-I", "-S", "-c", WATCHER_SCRIPT, path, message]
    witness = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
    try:
        yield
    finally:
        with suppress(OSError):
            witness.communicate(b"ended")


@contextmanager
def _loopback_alone() -> Iterator[None]:
    """Have a Ray that is started within it listen on loopback alone, as Ray does by itself on macOS and Windows; else it takes
    another address of the machine in place of 127.0.0.1."""
    from ray._private import ray_constants

    before = ray_constants.ENABLE_RAY_CLUSTER  # read as Ray was imported
    with _environment({ray_constants.ENABLE_RAY_CLUSTERS_ENV_VAR: "0"}):  # for the processes that it starts
        ray_constants.ENABLE_RAY_CLUSTER = False
        try:
            yield
        finally:
            ray_constants.ENABLE_RAY_CLUSTER = before


@cache
def _token() -> str:
    """A secret that Ray's processes of this one ask each other for."""
    return secrets.token_hex(32)


@contextmanager
def _environment(values: Mapping[str, str | None]) -> Iterator[None]:
    """Set variables, or remove those that are None, and set them back."""
    before = {name: os.environ.get(name) for name in values}
    try:
        _set(values)
        yield
    finally:
        _set(before)


def _set(values: Mapping[str, str | None]) -> None:
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


@contextmanager
def _socket_folder() -> Iterator[str]:
    """A folder of this user alone, of a short name: sockets' paths have 107 letters at most."""
    folder = tempfile.mkdtemp(prefix="ray-", dir="/tmp" if os.path.isdir("/tmp") else None)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _lost_part(ray: Any) -> str:
    """Return what of Ray does not answer any more on which this process depends, its node's raylet or the cluster's head; ""
    where both do, and of a Ray client, whose calls fail by themselves."""
    node = ray._private.worker.global_worker.node
    if node is None or not ray.is_initialized():
        return ""
    host, _, port = node.gcs_address.rpartition(":")
    parts: list[tuple[str, Any]] = [("head (gcs_server)", (host.strip("[]"), int(port)))]
    path = node.raylet_socket_name.removeprefix("unix://")
    if hasattr(socket, "AF_UNIX") and not path.startswith("tcp:"):
        parts.insert(0, ("raylet", path))
    for name, address in parts:
        family = socket.AF_UNIX if isinstance(address, str) else socket.AF_INET6 if ":" in host else socket.AF_INET
        with socket.socket(family, socket.SOCK_STREAM) as connection:
            connection.settimeout(CONNECT_TIMEOUT_S)
            try:
                connection.connect(address)
            except TimeoutError:
                continue  # busy
            except OSError:
                return name
    return ""


def _room(ray: Any, gpus: float) -> int:
    """Return how many actors the cluster has cores and GPUs for."""
    there = ray.cluster_resources()
    room = there.get("CPU", 0.0)
    return max(1, int(min(room, there.get("GPU", 0.0) / gpus) if gpus else room))


def _check_gpus(ray: Any, gpus: float) -> None:
    """Raise `UnisimError` where no actor would ever find room: no node joins a Ray of this machine."""
    there = ray.cluster_resources().get("GPU", 0.0)
    if there < gpus:
        raise UnisimError(
            f"Ray finds {there:g} GPUs on this machine, and a worker is to have {gpus:g}; name the address of a cluster"
        )


def _instruction_set() -> dict[str, str]:
    """Return the variable that has workers compute with the instruction set of this process: their bytes depend on it."""
    return {VARIANT_VARIABLE: variant()} if library() is not None else {}


class _Actor:
    """Ray actor that runs in a worker's process."""

    def make(self, make: MakeFunction[Any, Any]) -> Outcome[Any]:
        prepared = attempt(PREPARING, make)
        self._function = prepared.result
        return Outcome(PREPARING, error=prepared.error, details=prepared.details)

    def run(self, index: int, unit: Any) -> Outcome[Any]:
        assert self._function is not None
        return attempt(index, self._function, unit)


@dataclass(eq=False)
class _Worker:
    """An actor, and the outcome that it works at."""

    actor: Any
    awaited: Any
    index: int = PREPARING


class _Pool:
    def __init__(self, ray: Any, make: MakeFunction[Any, Any], gpus: float) -> None:
        self.ray, self.make_reference = ray, ray.put(make)
        # Ray's own retries would hold a unit until a lost node is back, so units are dispatched anew here
        self.actor = ray.remote(_Actor).options(
            num_cpus=1, num_gpus=gpus, max_restarts=0, max_task_retries=0, scheduling_strategy="SPREAD",
            runtime_env={"env_vars": {**dict.fromkeys(THREAD_VARIABLES, "1"), **_instruction_set()}},
        )  # fmt: skip

    def start(self, number: int) -> _Worker:
        actor = self.actor.remote()
        return _Worker(actor, actor.make.remote(self.make_reference))

    def send(self, worker: _Worker, index: int, unit: Any) -> None:
        worker.awaited, worker.index = worker.actor.run.remote(index, unit), index

    def finished(self, busy: Sequence[_Worker]) -> Iterator[tuple[_Worker, Outcome[Any] | None]]:
        awaited = {worker.awaited: worker for worker in busy}
        done: list[Any] = []
        while not done:
            try:
                done, _ = self.ray.wait(list(awaited), num_returns=1, timeout=WATCH_INTERVAL_S)
            except (ConnectionError, self.ray.exceptions.RayError) as error:
                raise ProcessLost(
                    f"the connection to Ray is lost: {in_a_line(error)}; continue with --resume"
                ) from error
            if not done and (part := _lost_part(self.ray)):
                raise ProcessLost(f"Ray's {part} was ended from outside (out of memory?); continue with --resume")
        for reference in done:
            yield awaited[reference], self._outcome(awaited[reference])

    def _outcome(self, worker: _Worker) -> Outcome[Any] | None:
        try:
            outcome: Outcome[Any] = self.ray.get(worker.awaited)
            return outcome
        except self.ray.exceptions.RayError as error:
            if missing := re.search(r"[Nn]o module named \S+", str(error)):
                lacks = "install unisim_blender, the same version, on all nodes"
                return Outcome(worker.index, error=UnisimError(f"a node of the cluster has n{missing[0][1:]}; {lacks}"))
            if isinstance(error, self.ray.exceptions.RayTaskError):  # what was sent could not be read there
                return Outcome(worker.index, error=RuntimeError(in_a_line(error)))
            return None

    def end(self, worker: _Worker) -> None:
        with suppress(Exception):  # it, its node or the cluster may be gone
            self.ray.kill(worker.actor)
