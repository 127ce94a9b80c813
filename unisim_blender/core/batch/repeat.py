"""The command that repeats a unit alone, to see it fail."""

from __future__ import annotations

import shlex

from ..prepare.scenario_plan import RenderOptions
from .store import Store
from .units import FormatsUnit, RolloutUnit, Unit


def repeat_command(unit: Unit, store: Store, scenario: str) -> str:
    """Return the command line that renders a unit's frames, or drives its rollout, into a folder of its own. ``scenario`` is
    the object of its variant's scenario. A scenario with times of its own is rendered whole."""
    options = [*_options(unit.options), "--out", f"repeat-{unit.name}"]
    if isinstance(unit, RolloutUnit):
        seed = [] if unit.asked.seed is None else ["--seed", str(unit.asked.seed)]
        return shlex.join(["unisim", "drive", store.where(scenario), "--driver", unit.driver, *seed, *options])
    if isinstance(unit, FormatsUnit):
        names = [word for name in unit.formats for word in (["--video"] if name == "video" else ["--format", name])]
        passes = ["--passes", ",".join(unit.options.passes)] if unit.options.passes else []
        chosen = ["--frames", unit.options.frames] if unit.options.frames else []
        return shlex.join(["unisim", "render", store.where(scenario), *chosen, *passes, *names, *options])
    frames = ",".join(str(one.moment.frame) for one in unit.work if one.moment.frame is not None)
    which = ["--frames", frames] if frames else []
    passes = ["--passes", ",".join(unit.options.passes)] if unit.options.passes else []
    return shlex.join(["unisim", "render", store.where(scenario), *which, *passes, *options])


def _options(options: RenderOptions) -> list[str]:
    """Return the options that `unisim render` and `unisim drive` share."""
    found: list[str] = []
    for name, value in (
        ("sensors", ",".join(options.sensors or ())),
        ("width", options.width),
        ("quality", options.quality),
        ("renderer", options.renderer),
        ("scene", options.scene),
        ("device", options.device if options.device != "cpu" else None),
    ):
        if value:
            found += [f"--{name}", str(value)]
    return found
