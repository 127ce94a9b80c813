"""The command that repeats a unit or a variant alone, to see it fail."""

from __future__ import annotations

import shlex
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from ..prepare.scenario_plan import RenderOptions
from .store import Store
from .units import FormatsUnit, RolloutUnit, Unit


def repeat_command(unit: Unit, store: Store, scenario: str) -> str:
    """Return the command line that renders a unit's frames, or drives its rollout, into a folder of its own. ``scenario`` is
    the object of its variant's scenario. A scenario with times of its own is rendered whole."""
    options, driver, seed = unit.options, None, None
    formats: Collection[str] = ()
    if isinstance(unit, RolloutUnit):
        driver, seed, formats = unit.driver, unit.asked.seed, unit.formats
    elif isinstance(unit, FormatsUnit):
        formats = unit.formats
    elif frames := ",".join(str(one.moment.frame) for one in unit.work if one.moment.frame is not None):
        options = replace(options, frames=frames)
    command, name, *more = repeat_words(scenario, options, driver, seed, formats)
    return shlex.join(["unisim", command, store.where(name), *more, "--out", f"repeat-{unit.name}"])


def repeat_words(
    scenario: str,
    options: RenderOptions,
    driver: str | None,
    seed: int | None = None,
    formats: Collection[str] = (),
) -> list[str]:
    """Return the words of a command that renders a scenario, or drives through it, as a batch with these options does: what
    follows `unisim`, without the folder to write. The second one is ``scenario``. ``formats`` are those of whole runs."""
    names = [word for name in formats for word in (["--video"] if name == "video" else ["--format", name])]
    if driver is not None:
        seeds = [] if seed is None else ["--seed", str(seed)]
        return ["drive", scenario, "--driver", driver, *seeds, *names, *_options(options)]
    passes = ["--passes", ",".join(options.passes)] if options.passes else []
    frames = ["--frames", options.frames] if options.frames else []
    return ["render", scenario, *frames, *passes, *names, *_options(options)]


def _options(options: RenderOptions) -> list[str]:
    """Return the options that `unisim render` and `unisim drive` share."""
    found: list[str] = []
    for name, value in (
        ("sensors", ",".join(options.sensors or ())),
        ("width", options.width),
        ("quality", options.quality),
        ("renderer", options.renderer),
        ("scene", options.scene and _whole(options.scene)),
        ("device", options.device if options.device != "cpu" else None),
    ):
        if value:
            found += [f"--{name}", str(value)]
    return found


def _whole(place: Path | str) -> str:
    """Return a path that holds in every folder; a URL as it is."""
    return str(place) if "://" in str(place) else str(Path(place).absolute())
