"""The server of `sensorsim`: on loopback as plain text, elsewhere through TLS and with a token. Signals stop it."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import grpc

from ..errors import UnisimError
from ..formats.alpasim.endpoints import MOST_BYTES, is_loopback, read_file
from .scenes import ServedScene
from .service import Sensorsim
from .turns import FairQueue

REQUEST_BYTES = 8 << 20
"""Largest size of a request: a thousand objects have two hundred thousand bytes."""
MOST_CONNECTIONS, MOST_STREAMS, MOST_CALLS = 64, 32, 256
"""Connections, calls of a connection at a time, calls at a time."""
IDLE_MS = 600_000
"""A connection without calls is closed."""
GRACE_S = 5.0
"""Longest wait for running calls when the server stops."""
SHORTEST_TOKEN = 16


@dataclass(frozen=True)
class Listening:
    """Where to listen. ``certificate`` and ``key`` are PEM files; ``token`` is what callers state. Raises `UnisimError` for what
    another machine could reach without them."""

    host: str = "127.0.0.1"
    port: int = 0
    certificate: Path | None = None
    key: Path | None = None
    token: str | None = None

    def __post_init__(self) -> None:
        if (self.certificate is None) != (self.key is None):
            raise UnisimError("--tls-cert and --tls-key: give both or neither")
        if self.token is not None and (len(self.token) < SHORTEST_TOKEN or not self.token.isascii()):
            raise UnisimError(f"--token-file: a token must be at least {SHORTEST_TOKEN} ASCII characters")
        if not is_loopback(self.host) and (self.certificate is None or self.token is None):
            raise UnisimError(
                f"--host {self.host}: other machines could reach it, which takes --tls-cert, --tls-key and --token-file"
            )

    @property
    def address(self) -> str:
        """The address for gRPC."""
        return f"[{self.host.strip('[]')}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


async def serve(
    scenes: dict[str, ServedScene],
    where: Listening,
    call_s: float,
    stop: asyncio.Event,
    on_ready: Callable[[int], object] = lambda port: None,
) -> None:
    """Serve scenes until ``stop`` is set. ``on_ready`` gets the port once calls are taken. Raises `UnisimError` where there is
    nothing to listen at."""
    turns = FairQueue()
    service = Sensorsim(scenes, turns, call_s, where.token)
    server = grpc.aio.server(
        options=[
            ("grpc.max_receive_message_length", REQUEST_BYTES),
            ("grpc.max_send_message_length", MOST_BYTES),
            ("grpc.max_concurrent_streams", MOST_STREAMS),
            ("grpc.max_allowed_incoming_connections", MOST_CONNECTIONS),
            ("grpc.max_connection_idle_ms", IDLE_MS),
            # else a second server at the port would take every other call
            ("grpc.so_reuseport", 0),
        ],
        maximum_concurrent_rpcs=MOST_CALLS,
    )
    server.add_generic_rpc_handlers((service.handler(),))
    port = _listen(server, where)
    working = asyncio.create_task(turns.run_until_closed())
    try:
        await server.start()
        on_ready(port)
        await stop.wait()
    finally:
        await server.stop(GRACE_S)
        working.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await working


def serve_until_signalled(
    scenes: dict[str, ServedScene], where: Listening, call_s: float, on_ready: Callable[[int], object]
) -> None:
    """Serve scenes until the process gets SIGINT or SIGTERM: calls that run are then finished, and no others are taken."""

    async def run() -> None:
        stop, loop = asyncio.Event(), asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            if sys.platform == "win32":
                signal.signal(number, lambda *_: loop.call_soon_threadsafe(stop.set))
            else:
                loop.add_signal_handler(number, stop.set)
        await serve(scenes, where, call_s, stop, on_ready)

    asyncio.run(run())


def _listen(server: Any, where: Listening) -> int:
    try:
        if where.certificate is None or where.key is None:
            port = server.add_insecure_port(where.address)
        else:
            pair = (read_file(where.key), read_file(where.certificate))
            port = server.add_secure_port(where.address, grpc.ssl_server_credentials([pair]))
    except RuntimeError as error:
        raise UnisimError(f"{where.address}: cannot be listened at: it is taken, or not this machine's") from error
    if not port:
        raise UnisimError(f"{where.address}: cannot be listened at: it is taken, or not this machine's")
    return int(port)
