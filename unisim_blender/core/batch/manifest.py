"""The manifest of a batch, merged from the records of its units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from ..render.code_identity import code_identity
from .plan import BatchPlan
from .records import FORMATS, UnitRecord, scenario_name
from .repeat import repeat_words

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
    for one in plan.variants:
        scenario = scenario_name(one.job.name)
        entry = {**one.about, "repeat": repeat_words(scenario, plan.options, one.job.driver, one.job.seed, one.formats)}
        if one.moments is not None:
            entry["moments"] = one.moments
            if one.formats and one.job.name in formats:
                entry["files"] = _files(formats[one.job.name].files)
        elif (record := records.get(units[one.job.name])) is not None:
            entry["rollout"] = {"files": _files(record.files), "scores": record.scores}
        variants[one.job.name] = entry
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
    return {name: asdict(one) for name, one in files.items()}
