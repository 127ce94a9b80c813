"""Which of a long drive's images, or sweeps, a step may draw from, and their reading ahead of time by another thread.

What a step may draw from follows from its number alone, never from how fast files are read, so that a seed gives the same
weights on every machine, resumed or not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from threading import Lock

import numpy as np
from numpy.typing import NDArray


class Window:
    """A window over ``count`` items in a fixed random order, which begins with the items ``first`` and comes round.

    At first it holds those alone. It grows by an item every ``steps`` steps; once it holds ``slots - ahead``, a new one replaces
    the oldest. ``load(item, slot)`` is called by a thread named ``name`` for what is due, from the first step on ``ahead`` items
    in advance, and fills the slot; a step that is earlier helps it or waits for it, and raises what it raised.
    """

    def __init__(
        self,
        count: int,
        slots: int,
        ahead: int,
        steps: int,
        first: Sequence[int],
        seed: Sequence[int],
        load: Callable[[int, int], None],
        name: str,
    ) -> None:
        self._slots, self._ahead, self._steps, self._load_item = slots, ahead, steps, load
        self.capacity = min(count, slots - ahead)
        begin = np.asarray(first, np.int64)[: self.capacity]
        others = np.setdiff1d(np.arange(count), begin)
        self._order = np.concatenate([begin, np.random.default_rng(list(seed)).permutation(others)])
        self._begin = max(1, len(begin))
        self._due: dict[int, Future[None]] = {}
        """By place in the order, counted on through its rounds."""
        self._worker, self._taking = ThreadPoolExecutor(1, name), Lock()
        self.slot = np.full(count, -1)
        """Slot of each item; -1 for those not read yet."""
        self.start(0)

    def places(self, step: int) -> range:
        """Places in the order, counted on through its rounds, that a step may draw from."""
        end = self._begin + step // self._steps
        if self.capacity == len(self._order):
            end = min(end, self.capacity)
        return range(max(0, end - self.capacity), end)

    def arrived(self, step: int) -> list[int]:
        """The items that a step may draw from and the one before it may not."""
        if step == 0:
            return self._order[: self._begin].tolist()
        return [
            int(self._order[place % len(self._order)])
            for place in self.places(step)
            if place not in self.places(step - 1)
        ]

    def start(self, step: int) -> None:
        """Have the step's items, and those of the next steps under way; before the first step its own alone, which wait for
        nothing then."""
        places = self.places(step)
        ahead = places.stop + (self._ahead if step else 0)
        if self.capacity == len(self._order):
            ahead = min(ahead, self.capacity)
        for place in [place for place in self._due if not places.start <= place < ahead]:
            gone = self._due.pop(place)
            if not gone.cancel():
                wait([gone])  # what is being read must not be written over another's slot
        for place in range(places.start, ahead):
            if place not in self._due:
                self._due[place] = self._worker.submit(self._load, place)

    def wait(self, item: int) -> None:
        """Have one of the items that the window begins with, which may then be drawn from."""
        place = int(np.flatnonzero(self._order[: self._begin] == item)[0])
        self._have([place])
        self.slot[item] = place % self._slots

    def advance(self, step: int) -> NDArray[np.int64]:
        """Return the items (K,), increasing, that a step may draw from, once they are read."""
        self.start(step)
        places = self.places(step)
        self._have(places)
        here = self._order[np.arange(places.start, places.stop) % len(self._order)]
        self.slot[here] = np.arange(places.start, places.stop) % self._slots
        return np.sort(here)

    def _have(self, places: Sequence[int]) -> None:
        """Have what lies at places. Rather than to wait for the other thread, which reads the first, this one reads the last."""
        for place in reversed(places):
            with self._taking:
                if not self._due[place].cancel():
                    continue
                self._due[place] = read = Future[None]()
                read.set_running_or_notify_cancel()
            try:
                self._load(place)
            except BaseException as error:
                read.set_exception(error)
                raise
            read.set_result(None)
        for place in places:
            self._due[place].result()

    def _load(self, place: int) -> None:
        self._load_item(int(self._order[place % len(self._order)]), place % self._slots)
