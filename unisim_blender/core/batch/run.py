"""Run a batch: its plan is noted, units without a record are run, the manifest is merged from the records."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field

from ..errors import OutputError
from ..executors import Executor
from ..executors.executor import WorkerState, sentence
from ..files import remove_partial_files
from ..json_file import json_bytes
from ..render.code_identity import code_identity
from ..render.tracers.surfels.build import Step
from ..scenario import rebased, scenario_to_json
from ..scenes.recipe import difference, environment
from .manifest import MANIFEST_NAME, make_manifest, repeat_command
from .plan import PLAN_NAME, BatchPlan, FormatsUnit, RolloutUnit, Shard, Unit
from .records import FAILURES, RECORDS, Store, UnitRecord, read_unit_record, record_name, scenario_name
from .report import write_report
from .work import UnitRunning, finished_record


@dataclass(frozen=True)
class Failure:
    """A unit that failed: why, and the command that repeats it alone."""

    unit: str
    variant: str
    reason: str
    command: str
    details: str = ""


@dataclass(frozen=True)
class BatchReport:
    """Result of a run. ``asked``, ``rendered`` and ``shared`` count images and sweeps of the whole batch; ``units_run``
    and ``captures_run`` those of this run, ``units_kept`` what an earlier one had finished."""

    asked: int
    rendered: int
    shared: int
    units: int
    units_run: int
    units_kept: int
    captures_run: int
    seconds: float
    failures: tuple[Failure, ...] = field(default_factory=tuple)


def run_batch(
    plan: BatchPlan,
    store: Store,
    executor: Executor,
    jobs: int | None = 1,
    resume: bool = False,
    on_unit: Callable[[Unit, Failure | None], object] = lambda unit, failure: None,
    on_reused: Callable[[int], object] = lambda count: None,
    on_step: Callable[[Step], object] = lambda step: None,
    shard: Shard | None = None,
    on_worker: Callable[[WorkerState, Unit | None], object] = lambda state, unit: None,
) -> BatchReport:
    """Run the units of a batch into a store, write formats of variants whose captures are all there, manifest and report.

    ``on_unit`` is called after each unit, with its failure if it failed; ``on_reused`` with the number of units that were
    finished before, then with that of formats' units; ``on_step`` at each step of preparing a scene, before workers load it;
    ``on_worker`` when a worker's state changes, with its unit.

    Of a ``shard``, its units alone are run, and others may run beside it: those that are finished are kept, as by ``resume``.
    The shard after which every unit has a record writes formats, manifest and report.

    Raises `OutputError` where the store is not empty and ``resume`` is not set, holds another batch, or cannot be written.
    Finished units are kept in every case.
    """
    started = time.monotonic()
    resume = resume or shard is not None
    mine = plan.units if shard is None else shard.of(plan.units)
    document = plan.document()
    _note(plan, document, store, resume, alone=shard is None)
    sizes = store.sizes() if resume else {}
    records: dict[str, UnitRecord] = {}
    for unit in mine if resume else ():
        if (record := finished_record(store, unit, sizes)) is not None:
            records[unit.name] = record
    to_do = [unit for unit in mine if unit.name not in records]
    on_reused(len(records))
    for unit in {unit.scene: unit for unit in to_do if unit.captures or isinstance(unit, RolloutUnit)}.values():
        for step in unit.plan.recipe.steps():
            on_step(step)
    reused, failures, formats = len(records), list[Failure](), dict[str, UnitRecord]()
    device = plan.options.device
    digest, code = hashlib.sha256(document).hexdigest(), code_identity()["sha256"]
    running = UnitRunning(store, digest, code, device, environment(device))

    def run(units: Sequence[Unit], done: dict[str, UnitRecord]) -> None:
        def on_state(state: WorkerState) -> None:
            on_worker(state, None if state.index is None else units[state.index])

        scenes = [unit.scene for unit in units]
        with closing(executor.run(running, units, jobs, scenes, on_state)) as outcomes:
            for outcome in outcomes:
                unit, failure = units[outcome.index], None
                noted = f"{FAILURES}/{unit.name}.json"
                if outcome.error is None:
                    done[unit.name] = outcome.get()
                    if noted in sizes:
                        store.remove(noted)
                else:
                    command = repeat_command(unit, store, scenario_name(unit.variant))
                    failure = Failure(unit.name, unit.variant, sentence(outcome.error), command, outcome.details)
                    failures.append(failure)
                    store.write(noted, json_bytes(vars(failure)))
                on_unit(unit, failure)

    run(to_do, records)
    units_run = len(records) - reused
    captures_run = sum(unit.captures for unit in to_do if unit.name in records)
    if shard is not None:
        records = _every_record(plan, store)
    if shard is None or len(records) == len(plan.units):
        whole = _formats_units(plan, records)
        for formats_unit in whole if resume else ():
            if (record := finished_record(store, formats_unit, sizes)) is not None:
                formats[formats_unit.name] = record
        on_reused(len(formats))
        run([formats_unit for formats_unit in whole if formats_unit.name not in formats], formats)
        if store.folder is not None and shard is None:
            remove_partial_files(store.folder)  # of workers that were lost
        store.write(MANIFEST_NAME, json_bytes(make_manifest(plan, records, formats)))
        write_report(store)
    return BatchReport(
        **plan.counts(), units=len(mine), units_run=units_run, units_kept=reused,
        captures_run=captures_run, seconds=time.monotonic() - started, failures=tuple(failures),
    )  # fmt: skip


def _formats_units(plan: BatchPlan, records: Mapping[str, UnitRecord]) -> list[FormatsUnit]:
    """Return the units that write formats of variants whose captures are all there."""
    entries = {identity: entry for record in records.values() for identity, entry in record.captures.items()}
    units = []
    for variant in plan.variants:
        if variant.moments is None or not variant.formats:
            continue
        wanted = {identity for captures in variant.moments.values() for identity in captures.values()}
        if wanted <= entries.keys():
            own = {identity: entries[identity] for identity in sorted(wanted)}
            options = plan.options
            units.append(
                FormatsUnit(
                    variant.job.name,
                    options,
                    variant.plan,
                    variant.formats,
                    variant.moments,
                    own,
                    inputs=variant.inputs,
                )
            )
    return units


def _every_record(plan: BatchPlan, store: Store) -> dict[str, UnitRecord]:
    """Return the records of all units, or of none where some are missing yet."""
    there = store.sizes(RECORDS)
    if any(record_name(unit.name) not in there for unit in plan.units):
        return {}
    by_name = {unit.name: read_unit_record(store, unit.name) for unit in plan.units}
    return {name: record for name, record in by_name.items() if record is not None}


def _note(plan: BatchPlan, document: bytes, store: Store, resume: bool, alone: bool) -> None:
    """Write the plan and the variants' scenarios, or check that the store holds this batch. Who is ``alone`` there clears up what
    killed processes were writing."""
    there = store.read(PLAN_NAME)
    if there is not None and resume:
        if there != document:
            raise OutputError(
                f"{store.where(PLAN_NAME)}: is another batch: {_difference(there, document)}; name another place"
            )
    elif there is not None or (store.sizes() and not resume):
        raise OutputError(
            f"{store.url}: is not empty; name another place, or continue the batch it holds with --resume"
        )
    folder = store.folder
    if folder is not None and alone:
        remove_partial_files(folder)
    for variant in plan.variants:
        name = scenario_name(variant.job.name)
        if there is None:
            moved = rebased(
                variant.job.scenario, (folder or variant.job.scenario.path.parent) / name, absolute=folder is None
            )
            store.write(name, json_bytes(scenario_to_json(moved)))
    # the plan last: where it is, the scenarios are
    if there is None:
        store.write(PLAN_NAME, document)


def _difference(there: bytes, document: bytes) -> str:
    """Say in which member two plans differ."""
    try:
        old, new = json.loads(there), json.loads(document)
        names = [name for name in new if old.get(name) != new[name]]
        if names[:1] == ["environment"] and isinstance(old.get("environment"), dict):
            return f"here {difference(old['environment'], new['environment'])}"
    except (ValueError, AttributeError, RecursionError):
        names = []
    return f"its {names[0]} differs" if names else "it cannot be read"
