"""The plan of a batch: its variants opened, their captures identified, and each capture given to one unit of work.

A unit is some captures of a scenario, or one closed-loop rollout. Each can be repeated at any time.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import OutputError
from ..export.formats import RUN_FORMATS, check_formats, rendered_drive
from ..json_file import json_bytes
from ..memo import memo_scope
from ..output.frame_files import labels_digest
from ..prepare.scenario_plan import RenderOptions, plan_scenario, scenario_hash, sequence_formats
from ..remote.copies import Copy, copies_used
from ..render.code_identity import code_identity
from ..scenario.simulation import SimulationSpec
from ..scenario.types import SEQUENCE_FORMATS, Scenario
from ..scenes.recipe import environment
from ..scenes.scene import OpenScenes, other_scenes
from ..sequence.manifest import LABELS
from ..sequence.plan import CaptureIdentities, Identity, RenderPlan
from ..simulation.drivers import driver_named
from ..world.captures import Moment
from .jobs import BatchJob
from .records import CaptureEntry


@dataclass(frozen=True)
class MomentWork:
    """Outputs that a unit makes of a moment: images and sweeps by name, and the labels where their digest is given."""

    moment: Moment
    captures: Mapping[str, Identity]
    labels: str | None


@dataclass(frozen=True)
class CaptureUnit:
    """Moments of a variant. ``scene`` is equal for units that one loaded scene renders."""

    name: str
    variant: str
    scene: str
    options: RenderOptions
    plan: RenderPlan
    work: tuple[MomentWork, ...]
    inputs: tuple[Copy, ...] = ()
    """Copies of inputs that lie at URLs."""

    @property
    def captures(self) -> int:
        """Number of images and sweeps."""
        return sum(len(item.captures) for item in self.work)


@dataclass(frozen=True)
class RolloutUnit:
    """One closed-loop rollout of a variant."""

    name: str
    variant: str
    scene: str
    options: RenderOptions
    scenario: Scenario
    driver: str
    asked: SimulationSpec
    plan: RenderPlan
    inputs: tuple[Copy, ...] = ()
    formats: tuple[str, ...] = ()
    """Of the whole run, as `unisim drive --format` has them."""
    captures: int = 0


@dataclass(frozen=True)
class FormatsUnit:
    """The files of formats that are made of all captures of a variant, after these. ``moments`` are the identities of its
    captures by name, by its moments' names; ``entries`` are those captures' files."""

    variant: str
    options: RenderOptions
    plan: RenderPlan
    formats: tuple[str, ...]
    moments: Mapping[str, Mapping[str, str]]
    entries: Mapping[str, CaptureEntry]
    scene: str = ""
    inputs: tuple[Copy, ...] = ()
    captures: int = 0

    @property
    def name(self) -> str:
        """The variant's: it has one of these units."""
        return self.variant


Unit = CaptureUnit | RolloutUnit | FormatsUnit


@dataclass(frozen=True)
class Shard:
    """One of ``count`` parts of a batch, counted from 0."""

    number: int
    count: int

    def of(self, units: Sequence[Unit]) -> list[Unit]:
        """Return this part of the units: parts are of nearly one size, and units of one scene lie in as few as can be."""
        ordered = sorted(units, key=lambda unit: unit.scene)
        first, stop = (len(ordered) * part // self.count for part in (self.number, self.number + 1))
        return ordered[first:stop]


PLAN_NAME = "batch.json"
MOMENTS_PER_UNIT = 10
"""Moments of a unit."""


@dataclass(frozen=True)
class Variant:
    """A job, opened. ``moments`` are the identities of its captures by name, by its moments' names; None of a rollout.
    ``formats`` are made of all of them, in their order."""

    job: BatchJob
    about: dict[str, Any]
    moments: dict[str, dict[str, str]] | None
    plan: RenderPlan
    formats: tuple[str, ...]
    inputs: tuple[Copy, ...]


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
            {"unit": unit.name, "variant": unit.variant, "scene": unit.scene, "makes": _products(unit)}
            for unit in self.units
        ]
        return json_bytes(
            {
                "format": "unisim-batch-plan",
                "version": 1,
                "code": code_identity(),
                "environment": environment(self.options.device),
                "captures": self.counts(),
                "variants": {variant.job.name: variant.about for variant in self.variants},
                "units": units,
            }
        )

    def with_formats(self) -> tuple[str, ...]:
        """Return the names of the variants of whose captures whole formats are made, after these."""
        return tuple(variant.job.name for variant in self.variants if variant.moments is not None and variant.formats)

    def counts(self) -> dict[str, int]:
        """Return the counts of images and sweeps of open-loop variants."""
        return {"asked": self.asked, "rendered": self.rendered, "shared": self.asked - self.rendered}


@memo_scope()
def plan_batch(
    jobs: Sequence[BatchJob],
    options: RenderOptions,
    moments: int = MOMENTS_PER_UNIT,
    formats: Collection[str] = (),
    on_job: Callable[[BatchJob], object] = lambda job: None,
) -> BatchPlan:
    """Open all jobs, and divide what differs among their captures into units of so many ``moments``.

    A capture that several variants share belongs to the first one's unit. ``formats`` of whole runs are written of every variant,
    beside those that its scenario asks for. Raises `UnisimError`.
    """
    variants: list[Variant] = []
    units: list[Unit] = []
    owned: set[str] = set()
    asked = rendered = 0
    scenes = OpenScenes()
    for job in jobs:
        with copies_used() as used:
            plan, prepared = plan_scenario(job.scenario, options, scenes)
        inputs = tuple(used.values())
        scene, wanted = scene_key(plan), _formats(job, plan, prepared.scenario, formats)
        about = {
            "scenario": {"name": prepared.scenario.name, "sha256": scenario_hash(prepared.scenario)},
            "parameters": dict(job.parameters),
            **({"formats": wanted} if wanted else {}),
            **({} if job.driver is None else {"driver": job.driver, "seed": job.seed}),
            **({"warnings": plan.about["warnings"]} if "warnings" in plan.about else {}),
        }
        name = f"{len(units):06d}"
        if job.driver is not None:
            driver_named(job.driver)  # one that is not there is told before anything runs
            asked_of = SimulationSpec(seed=job.seed)
            variants.append(Variant(job, about, None, plan, wanted, inputs))
            units.append(
                RolloutUnit(name, job.name, scene, options, job.scenario, job.driver, asked_of, plan, inputs, wanted)
            )
            on_job(job)
            continue
        identities, moments_captures, work = CaptureIdentities(plan), dict[str, dict[str, str]](), list[MomentWork]()
        for moment in plan.moments:
            captures = identities.of_moment(moment)
            asked += len(captures)
            new: dict[str, Identity] = {}
            for capture, identity in captures.items():
                if identity[0] not in owned:
                    owned.add(identity[0])
                    new[capture] = identity
            rendered += len(new)
            moments_captures[moment.name] = {capture: identity for capture, (identity, _) in captures.items()}
            labels = _labels(plan, moment)
            if labels is not None:
                moments_captures[moment.name][LABELS] = labels
                labels = None if labels in owned else labels
                owned.add(moments_captures[moment.name][LABELS])
            if new or labels is not None:
                work.append(MomentWork(moment, new, labels))
        variants.append(Variant(job, about, moments_captures, plan, wanted, inputs))
        for some in (tuple(work[first : first + moments]) for first in range(0, len(work), moments)):
            units.append(CaptureUnit(f"{len(units):06d}", job.name, scene, options, plan, some, inputs))
        on_job(job)
    return BatchPlan(tuple(variants), tuple(units), asked, rendered, options)


def _formats(job: BatchJob, plan: RenderPlan, scenario: Scenario, asked: Collection[str]) -> tuple[str, ...]:
    """Return the formats that are made of a whole variant, in their order. Raises `OutputError` where they cannot be."""
    every = {*sequence_formats(scenario), *asked}
    wanted = tuple(name for name in SEQUENCE_FORMATS if name in every)
    if job.driver is not None:
        for name in asked:
            if name not in RUN_FORMATS:
                raise OutputError(f"--format {name}: of rollouts there are {', '.join(RUN_FORMATS)}")
        wanted = tuple(name for name in wanted if name in RUN_FORMATS)
    check_formats(wanted, plan.settings, scenario.path)
    if "pandaset" in wanted:
        rendered_drive(plan)  # which tells of captures that make no log
    return wanted


def scene_key(plan: RenderPlan) -> str:
    """Return a digest of what a renderer loads: equal for plans that one renderer's scene renders."""
    own = {name: plan.scenes[name] for name in ("", *other_scenes(plan.drive)) if name in plan.scenes}
    settings = plan.settings
    parts = [
        own,
        settings.renderer,
        settings.quality,
        settings.device,
        settings.draw,
        settings.contact_shadows,
        settings.fill,
        settings.detail,
    ]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _labels(plan: RenderPlan, moment: Moment) -> str | None:
    if "labels" not in plan.settings.formats:
        return None
    return labels_digest(plan.drive, moment)


def _products(unit: Unit) -> list[str] | str:
    """Return what a unit makes: identities of captures, or a digest of the rollout's inputs."""
    if isinstance(unit, RolloutUnit):
        parts = [
            scenario_hash(unit.scenario), unit.driver, unit.asked.seed, repr(unit.plan.settings),
            sorted(unit.plan.scenes.values()), unit.plan.environment,
        ]  # fmt: skip
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
    identities: list[str] = []
    for item in unit.work if isinstance(unit, CaptureUnit) else ():
        identities += [identity for identity, _ in item.captures.values()]
        identities += [] if item.labels is None else [item.labels]
    return identities
