"""Units of work of a batch: some moments of a scenario, or one closed-loop rollout. Each can be repeated at any time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..prepare.scenario_plan import RenderOptions
from ..remote.copies import Copy
from ..scenario.simulation import SimulationSpec
from ..scenario.types import Scenario
from ..sequence.identity import Identity
from ..sequence.plan import RenderPlan
from ..world.captures import Moment
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
        return sum(len(one.captures) for one in self.work)


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
