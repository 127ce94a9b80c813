"""`unisim batch --on shards`: what a scheduler takes, and the part of a batch that a task of it runs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click

from ...batch.schedulers import SCHEDULERS, ShardedBatch

SHARDS = "shards"
MOST_SHARDS = 100
"""Without a number of them."""
_OTHERWISE = ("on", "resume", "units", "as_json", "scheduler", "shards", "image")
"""Options that a shard's command does not have from the command that wrote it."""


def shard_of(context: click.Context, option: click.Parameter, value: str | None) -> tuple[int, int] | None:
    """Return which part of a batch 0/20 is: its number, and how many there are."""
    if value is None:
        return None
    number, _, count = value.partition("/")
    if not (number.isdecimal() and count.isdecimal() and int(number) < int(count)):
        raise click.BadParameter(f"{value!r} is no part of a batch: 0/20 is the first of 20, and 19/20 the last")
    return int(number), int(count)


def show_shards(context: click.Context, units: int) -> None:
    """Print what the scheduler takes that the command names. ``units`` are those of the batch."""
    given = context.params
    count = given["shards"] or max(1, min(units, MOST_SHARDS))
    gpus = 1 if given["device"].startswith("cuda") else 0
    label = _label(Path(given["jobs_"][0]).stem)
    batch = ShardedBatch(label, list(_words(context)), count, given["jobs"] or 1, given["image"], gpus)
    click.echo(SCHEDULERS[given["scheduler"]](batch), nl=False)


def _label(text: str) -> str:
    """Return a name that every scheduler takes."""
    kept = "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in text)
    return f"unisim-{kept.strip('-')[:40]}".strip("-")


def _words(context: click.Context) -> Iterator[str]:
    """Yield the command as it was given, with whole paths, for another folder and machine."""
    yield from ("unisim", "batch")
    yield from (_whole(name) for name in context.params["jobs_"])
    for option in context.command.params:
        source = context.get_parameter_source(option.name or "")
        if not isinstance(option, click.Option) or option.name in _OTHERWISE:
            continue
        if source is not click.core.ParameterSource.COMMANDLINE:
            continue
        value = context.params[option.name or ""]
        if option.is_flag:
            yield option.opts[0]
            continue
        for one in value if option.multiple else (value,):
            yield option.opts[0]
            yield _whole(one) if isinstance(one, Path) or option.name == "out" else str(one)


def _whole(place: str | Path) -> str:
    return str(place) if "://" in str(place) else str(Path(place).absolute())
