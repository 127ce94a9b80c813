"""Executors by name: where units of work are run. Another one is a file in this folder and a line here, which
registers it."""

from __future__ import annotations

from ..errors import UnisimError
from .dispatch import Processes as Processes
from .dispatch import ThisProcess as ThisProcess
from .executor import EXECUTORS as EXECUTORS
from .executor import Executor as Executor
from .ray_cluster import ADDRESS_PATTERN
from .ray_cluster import RayCluster as RayCluster


def usual_executor(jobs: int, units: int) -> Executor:
    """Return what runs so many units where nobody names an executor: processes, where more than one would have work."""
    return EXECUTORS["processes" if jobs > 1 and units > 1 else "this-process"]


def executor_at(place: str, gpus: float = 0.0) -> Executor:
    """Return an executor by its name, or by the address of a Ray cluster: ``ray://HOST:PORT``, ``HOST:PORT``. Workers of Ray
    have ``gpus`` GPUs each. Raises `UnisimError`."""
    if ADDRESS_PATTERN.fullmatch(place):
        return RayCluster(place, gpus)
    if place == "ray":
        return RayCluster(gpus=gpus)
    if place not in EXECUTORS:
        raise UnisimError(f"{place}: is none of {', '.join(EXECUTORS)}, ray://HOST:PORT, HOST:PORT")
    return EXECUTORS[place]
