"""The plan of a batch: its variants opened, their captures identified, and each capture given to one unit."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import UnisimError
from ..json_file import json_bytes
from ..output.frame_files import labels_bytes
from ..prepare.scenario_plan import RenderOptions, plan_scenario, scenario_hash, sequence_formats
from ..prepare.scenes import other_scenes
from ..render.code_identity import code_identity
from ..scenario.simulation.document import SimulationSpec
from ..sequence.identity import CaptureIdentities, Identity
from ..sequence.manifest import LABELS
from ..sequence.plan import RenderPlan
from ..simulation.drivers import driver_named
from ..world.captures import Moment
from .jobs import Job
from .units import CaptureUnit, MomentWork, RolloutUnit, Unit

VARIANTS = "variants"
MOMENTS = 10
"""Moments of a unit."""


@dataclass(frozen=True)
class Variant:
    """A job, opened. ``moments`` are the identities of its captures by name, by its moments' names; None of a rollout."""

    job: Job
    about: dict[str, Any]
    moments: dict[str, dict[str, str]] | None


@dataclass(frozen=True)
class BatchPlan:
    """All variants and units of a batch. ``asked`` counts the images and sweeps that variants ask for, ``rendered`` those that
    differ."""

    variants: tuple[Variant, ...]
    units: tuple[Unit, ...]
    asked: int
    rendered: int
    options: RenderOptions

    def document(self) -> bytes:
        """Return what the batch is, as JSON: equal for equal inputs, settings and code."""
        units = [
            {"unit": unit.name, "variant": unit.variant, "scene": unit.scene, "makes": _made(unit)}
            for unit in self.units
        ]
        return json_bytes(
            {
                "format": "unisim-batch-plan",
                "version": 1,
                "code": code_identity(),
                "captures": self.counts(),
                "variants": {one.job.name: one.about for one in self.variants},
                "units": units,
            }
        )

    def counts(self) -> dict[str, int]:
        """Return the counts of images and sweeps of open-loop variants."""
        return {"asked": self.asked, "rendered": self.rendered, "shared": self.asked - self.rendered}


def plan_batch(
    jobs: Sequence[Job],
    options: RenderOptions,
    moments: int = MOMENTS,
    on_job: Callable[[Job], object] = lambda job: None,
) -> BatchPlan:
    """Open all jobs, and divide what differs among their captures into units of so many ``moments``.

    A capture that several variants share belongs to the first one's unit. Raises `UnisimError`.
    """
    variants: list[Variant] = []
    units: list[Unit] = []
    owned: set[str] = set()
    asked = rendered = 0
    for job in jobs:
        plan, prepared = plan_scenario(job.scenario, options)
        scene = scene_key(plan)
        about = {
            "scenario": {"name": prepared.scenario.name, "sha256": scenario_hash(prepared.scenario)},
            "parameters": dict(job.parameters),
            **({} if job.driver is None else {"driver": job.driver, "seed": job.seed}),
            **({"warnings": plan.about["warnings"]} if "warnings" in plan.about else {}),
        }
        name = f"{len(units):06d}"
        if job.driver is not None:
            driver_named(job.driver)  # one that is not there is told before anything runs
            asked_of = SimulationSpec(seed=job.seed)
            variants.append(Variant(job, about, None))
            units.append(RolloutUnit(name, job.name, scene, options, job.scenario, job.driver, asked_of, plan))
            on_job(job)
            continue
        if made_of_all := sequence_formats(prepared.scenario):
            raise UnisimError(f"{job.scenario.path}: outputs.formats: a batch writes no {made_of_all[0]}; leave it out")
        identities, found, work = CaptureIdentities(plan), dict[str, dict[str, str]](), list[MomentWork]()
        for moment in plan.moments:
            wanted = identities.of_moment(moment)
            asked += len(wanted)
            new: dict[str, Identity] = {}
            for capture, identity in wanted.items():
                if identity[0] not in owned:
                    owned.add(identity[0])
                    new[capture] = identity
            rendered += len(new)
            found[moment.name] = {capture: identity for capture, (identity, _) in wanted.items()}
            labels = _labels(plan, moment)
            if labels is not None:
                found[moment.name][LABELS] = labels
                labels = None if labels in owned else labels
                owned.add(found[moment.name][LABELS])
            if new or labels is not None:
                work.append(MomentWork(moment, new, labels))
        variants.append(Variant(job, about, found))
        for some in _chunks(work, moments):
            units.append(CaptureUnit(f"{len(units):06d}", job.name, scene, options, plan, some))
        on_job(job)
    return BatchPlan(tuple(variants), tuple(units), asked, rendered, options)


def scenario_name(variant: str) -> str:
    """Return the name of the object that holds a variant's scenario."""
    return f"{VARIANTS}/{variant}/scenario.json"


def scene_key(plan: RenderPlan) -> str:
    """Return a digest of what a renderer loads: equal for plans that one renderer's scene renders."""
    own = {name: plan.scenes[name] for name in ("", *other_scenes(plan.drive)) if name in plan.scenes}
    settings = plan.settings
    parts = [own, settings.renderer, settings.quality, settings.device, settings.draw, settings.contact_shadows]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _labels(plan: RenderPlan, moment: Moment) -> str | None:
    if "labels" not in plan.settings.formats:
        return None
    return hashlib.sha256(moment.name.encode() + b"\0" + labels_bytes(plan.drive, moment)).hexdigest()


def _chunks(work: Sequence[MomentWork], count: int) -> Iterator[tuple[MomentWork, ...]]:
    for first in range(0, len(work), count):
        yield tuple(work[first : first + count])


def _made(unit: Unit) -> list[str] | str:
    """Return what a unit makes: identities of captures, or a digest of the rollout's inputs."""
    if isinstance(unit, RolloutUnit):
        parts = [
            scenario_hash(unit.scenario), unit.driver, unit.asked.seed, repr(unit.plan.settings),
            sorted(unit.plan.scenes.values()), unit.plan.environment,
        ]  # fmt: skip
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
    found: list[str] = []
    for one in unit.work:
        found += [identity for identity, _ in one.captures.values()]
        found += [] if one.labels is None else [one.labels]
    return found
