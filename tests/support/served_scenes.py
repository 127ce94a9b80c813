"""A server of scenes in a thread of its own, and calls to it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import grpc

from unisim_blender.core.serve.scenes import ServedScene
from unisim_blender.core.serve.server import Listening, serve
from unisim_blender.core.serve.service import SERVICE


@contextmanager
def served(scenes: dict[str, ServedScene], where: Listening | None = None, call_s: float = 120.0) -> Iterator[str]:
    """Serve scenes while the block runs; gives the server's address."""
    ready, failed = threading.Event(), []
    stopping: list[Any] = []
    ports: list[int] = []

    def on_ready(port: int) -> None:
        ports.append(port)
        ready.set()

    async def main() -> None:
        stop = asyncio.Event()
        stopping.extend([asyncio.get_running_loop(), stop])
        await serve(scenes, where or Listening(), call_s, stop, on_ready)

    def run() -> None:
        try:
            asyncio.run(main())
        except BaseException as error:
            failed.append(error)
            ready.set()

    thread = threading.Thread(target=run)
    thread.start()
    assert ready.wait(60)
    if failed:
        raise failed[0]
    try:
        yield f"127.0.0.1:{ports[0]}"
    finally:
        loop, stop = stopping
        loop.call_soon_threadsafe(stop.set)
        thread.join(60)
    assert not thread.is_alive() and not failed, failed


def call(channel: Any, name: str, request: Any, answer: Any = None, **more: Any) -> Any:
    """Make one call; ``request`` may be bytes. ``answer`` is the message's class that is parsed, None for bytes."""
    data = request if isinstance(request, bytes) else request.SerializeToString()
    found = channel.unary_unary(f"/{SERVICE}/{name}")(data, timeout=more.pop("timeout", 120), **more)
    return found if answer is None else answer.FromString(found)


def fault_of(channel: Any, name: str, request: Any, **more: Any) -> tuple[str, str]:
    """The status and the details that a call fails with."""
    try:
        call(channel, name, request, **more)
    except grpc.RpcError as error:
        return error.code().name, error.details()
    return "OK", ""
