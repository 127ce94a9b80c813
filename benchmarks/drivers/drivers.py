"""The drivers that are compared, by name: our own, AlpaSim's protocol with a published policy behind it, and a stack that
perceives."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.simulation.drivers import Endpoint, driver_named
from unisim_blender.core.simulation.drivers.driver import DriverKind

ROUTE_FOLLOWER, PERCEPTION = "route_follower", "perception"
DRIVERS = ("log", "idm", ROUTE_FOLLOWER, PERCEPTION)
_WEIGHTS = "PERCEPTION_WEIGHTS"


@dataclass(frozen=True)
class Entry:
    """A driver under the ``name`` that it has in the table; ``driver`` and ``endpoint`` are as of `driver_named`."""

    name: str
    driver: str
    endpoint: Endpoint | None = None

    def kind(self) -> DriverKind:
        """Return what starts it. Raises `UnisimError`."""
        return driver_named(self.driver, self.endpoint)


@contextmanager
def entries(names: Sequence[str], weights: Path | None) -> Iterator[list[Entry]]:
    """Yield the drivers of these names. The route follower of `carla-driver-interface`, with its own defaults, is served on a
    loopback port meanwhile; ``weights`` is the folder of the detectors of `perception`. Raises `UnisimError`."""
    if PERCEPTION in names:
        if weights is None:
            raise UnisimError("--weights: perception needs the folder that examples.perception.train wrote")
        os.environ[_WEIGHTS] = str(weights.resolve())  # which processes inherit
    plain = {"log": "log", "idm": "idm", PERCEPTION: "examples.perception.driver:perception"}
    if ROUTE_FOLLOWER not in names:
        yield [Entry(name, plain[name]) for name in names]
        return
    from carla_driver_interface.policies import RouteFollowerPolicy
    from carla_driver_interface.server import serving

    with serving(RouteFollowerPolicy(), port=0, host="127.0.0.1") as port:
        served = Entry(ROUTE_FOLLOWER, "egodriver", Endpoint(f"127.0.0.1:{port}"))
        yield [served if name == ROUTE_FOLLOWER else Entry(name, plain[name]) for name in names]
