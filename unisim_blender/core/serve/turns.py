"""Turns at the one renderer: a client that asks for much keeps no other one waiting for more than one piece."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, TypeVar

ResultT = TypeVar("ResultT")
Wanted = Callable[[], bool]
"""Tells whether the result of a piece of work is still waited for."""
QueuedWork = Callable[[Wanted], ResultT]


class BusyError(Exception):
    """More work waits than is kept."""


@dataclass(eq=False)
class _Piece:
    work: QueuedWork[Any]
    until: float
    answer: asyncio.Future[Any]
    abandoned: bool = False

    def wanted(self) -> bool:
        """Whether someone still waits for it."""
        return not self.abandoned and time.monotonic() < self.until


@dataclass
class FairQueue:
    """Runs pieces of work one after the other in a thread, the clients' by turns.

    ``per_client`` pieces of a client wait at most, ``in_all`` of all clients. `run_until_closed` has to run beside.
    """

    per_client: int = 16
    in_all: int = 256
    _waiting: dict[str, deque[_Piece]] = field(default_factory=dict)
    _there_is: asyncio.Event = field(default_factory=asyncio.Event)
    _thread: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "render"))

    async def run(self, client: str, work: QueuedWork[ResultT], until: float) -> ResultT:
        """Return what a piece of work gives. Raises `BusyError`, and `TimeoutError` at ``until``, a time of `time.monotonic`; it
        is then dropped, as it is where this call is cancelled."""
        mine = self._waiting.get(client, ())
        if len(mine) >= self.per_client:
            raise BusyError(f"{self.per_client} requests of this client wait already")
        if sum(map(len, self._waiting.values())) >= self.in_all:
            raise BusyError(f"{self.in_all} requests wait already")
        piece = _Piece(work, until, asyncio.get_running_loop().create_future())
        self._waiting.setdefault(client, deque()).append(piece)
        self._there_is.set()
        try:
            result: ResultT = await asyncio.wait_for(piece.answer, max(0.0, until - time.monotonic()))
            return result
        finally:
            piece.abandoned = True

    async def run_until_closed(self) -> None:
        """Work until this is cancelled."""
        loop = asyncio.get_running_loop()
        try:
            while True:
                await self._there_is.wait()
                piece = self._next()
                if piece is None:
                    self._there_is.clear()
                    continue
                if not piece.wanted() or piece.answer.done():
                    continue
                await self._answer(loop, piece)
        finally:
            for pieces in self._waiting.values():
                for piece in pieces:
                    piece.abandoned = True
                    piece.answer.cancel()
            self._waiting.clear()
            self._thread.shutdown(wait=True, cancel_futures=True)

    async def _answer(self, loop: asyncio.AbstractEventLoop, piece: _Piece) -> None:
        try:
            result = await loop.run_in_executor(self._thread, piece.work, piece.wanted)
        except asyncio.CancelledError:
            piece.abandoned = True
            piece.answer.cancel()
            raise
        except Exception as error:  # noqa: BLE001  it is the caller's
            if not piece.answer.done():
                piece.answer.set_exception(error)
        else:
            if not piece.answer.done():
                piece.answer.set_result(result)

    def _next(self) -> _Piece | None:
        """Take the next piece of the client whose turn it is, who then comes last."""
        while self._waiting:
            client = next(iter(self._waiting))
            pieces = self._waiting.pop(client)
            piece = pieces.popleft()
            if pieces:
                self._waiting[client] = pieces
            if piece.wanted():
                return piece
        return None
