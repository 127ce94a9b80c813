"""The manifest of a batch, merged from the records of its units, and the commands that repeat a unit or a variant alone."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from ..prepare.scenario_plan import RenderOptions
from ..render.code_identity import code_identity
from .plan import BatchPlan, FormatsUnit, RolloutUnit, Unit
from .records import FORMATS, Store, UnitRecord, scenario_name


def repeat_command(unit: Unit, store: Store, scenario: str) -> str:
    """Return the command line that renders a unit's frames, or drives its rollout, into a folder of its own. ``scenario`` is
    the object of its variant's scenario. A scenario with times of its own is rendered whole."""
    options, driver, seed = unit.options, None, None
    formats: Collection[str] = ()
    if isinstance(unit, RolloutUnit):
        driver, seed, formats = unit.driver, unit.asked.seed, unit.formats
    elif isinstance(unit, FormatsUnit):
        formats = unit.formats
    elif frames := ",".join(str(item.moment.frame) for item in unit.work if item.moment.frame is not None):
        options = replace(options, frames=frames)
    command, name, *more = repeat_words(scenario, options, driver, seed, formats)
    return shlex.join(["unisim", command, store.where(name), *more, "--out", f"repeat-{unit.name}"])


def repeat_words(
    scenario: str, options: RenderOptions, driver: str | None, seed: int | None = None, formats: Collection[str] = ()
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
    words: list[str] = []
    for name, value in (
        ("sensors", ",".join(options.sensors or ())),
        ("width", options.width),
        ("quality", options.quality),
        ("renderer", options.renderer),
        ("scene", options.scene and whole_place(options.scene)),
        ("device", options.device if options.device != "cpu" else None),
    ):
        if value:
            words += [f"--{name}", str(value)]
    return words


def whole_place(place: Path | str) -> str:
    """Return a path that holds in every folder; a URL as it is."""
    return str(place) if "://" in str(place) else str(Path(place).absolute())


MANIFEST_NAME = "manifest.json"


def make_manifest(
    plan: BatchPlan, records: Mapping[str, UnitRecord], formats: Mapping[str, UnitRecord]
) -> dict[str, Any]:
    """Return the manifest: variants with the identities of their captures, the files of each capture, rollouts with
    their files and scores. It depends on nothing but the plan and the records.

    ``formats`` are the records of variants' formats, by their names.

    ``unfinished`` names the units without a record. ``repeat`` of a variant are the words after `unisim` of the command that
    makes it again, alone.
    """
    units = {unit.variant: unit.name for unit in plan.units}  # a rollout's variant has one unit
    variants: dict[str, Any] = {}
    for variant in plan.variants:
        scenario = scenario_name(variant.job.name)
        entry = {
            **variant.about,
            "repeat": repeat_words(scenario, plan.options, variant.job.driver, variant.job.seed, variant.formats),
        }
        if variant.moments is not None:
            entry["moments"] = variant.moments
            if variant.formats and variant.job.name in formats:
                entry["files"] = _files(formats[variant.job.name].files)
        elif (record := records.get(units[variant.job.name])) is not None:
            entry["rollout"] = {"files": _files(record.files), "scores": record.scores}
        variants[variant.job.name] = entry
    captures = {
        identity: {
            "files": _files(entry.files),
            **({"sees": list(entry.sees)} if entry.sees else {}),
            **({"samples": dict(entry.samples)} if entry.samples else {}),
        }
        for record in records.values()
        for identity, entry in record.captures.items()
    }
    return {
        "format": "unisim-batch",
        "version": 1,
        "code": code_identity(),
        "counts": {**plan.counts(), "units": len(plan.units)},
        "unfinished": [
            *(unit.name for unit in plan.units if unit.name not in records),
            *(f"{FORMATS}/{name}" for name in plan.with_formats() if name not in formats),
        ],
        "variants": variants,
        "captures": dict(sorted(captures.items())),
    }


def _files(files: Mapping[str, Any]) -> dict[str, Any]:
    return {name: asdict(file) for name, file in files.items()}
