"""What a scheduler is given: the command of a batch, of which each task runs one shard."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class ShardedBatch:
    """A batch in ``shards`` parts. ``words`` are its command with all options but which shard; paths in it are whole.

    ``name`` has letters, digits and dashes alone. ``processes`` are those of a shard, which share its ``gpus``. ``image`` is
    that of containers.
    """

    name: str
    words: Sequence[str]
    shards: int
    processes: int = 1
    image: str = "unisim"
    gpus: int = 0

    def with_shard(self, number: str) -> list[str]:
        """Return the command of the shard of a number, as the scheduler writes it in."""
        return [*self.words, "--units", f"{number}/{self.shards}"]


Written = Callable[[ShardedBatch], str]
SCHEDULERS: dict[str, Written] = {}
"""By name, what writes the file that a scheduler takes."""


def register(write: Written) -> Written:
    """Add a scheduler by its function's name."""
    SCHEDULERS[write.__name__] = write
    return write
