"""A worker of a batch: it loads a scene, renders a unit's captures, drives its rollout or writes a variant's formats, and stores
the files and a record of them."""

from __future__ import annotations

import hashlib
import json
import socket
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NoReturn

from ..errors import OutputError, UnisimError
from ..export.formats import write_runs, write_sequence
from ..files import write_file
from ..formats.rendered import MANIFEST
from ..json_file import json_bytes
from ..processes import single_threaded
from ..remote.copies import copies_used
from ..render.captures import StartCapture
from ..render.renderer import Renderer
from ..scenario import load_scenario, rebased, save_scenario
from ..scenes.recipe import check_code, check_environment
from ..sequence.manifest import LABELS, make_manifest, write_drive
from ..sequence.plan import RenderPlan
from ..sequence.records import STATE_FOLDER, CaptureRecord, read_records, write_record
from ..sequence.run import TIMINGS_NAME, Work, capture_renderer, render_moment
from ..world.captures import Capture
from .plan import PLAN_NAME, CaptureUnit, FormatsUnit, MomentWork, RolloutUnit, Unit, scene_key
from .records import (
    CAPTURES,
    FORMATS,
    RECORDS,
    ROLLOUTS,
    VARIANTS,
    CaptureEntry,
    Files,
    Store,
    StoredFile,
    UnitRecord,
    read_unit_record,
    write_unit_record,
)


@dataclass(frozen=True)
class UnitRunning:
    """Factory of the function that an executor calls for each unit. It pickles. ``plan`` is the digest of the batch's plan,
    ``code`` that of the code that made it, on a machine whose `environment` for a ``device`` was this."""

    store: Store
    plan: str
    code: str
    device: str
    environment: Mapping[str, str]

    def __call__(self) -> Callable[[Unit], UnitRecord]:
        """Return a worker's function, which holds the scene of the last unit. Raises `UnisimError` where this machine has other
        code, renders other bytes, or does not see the batch's store."""
        check_code(self.code)
        check_environment(self.environment, self.device)
        document = self.store.read(PLAN_NAME)
        if document is None or hashlib.sha256(document).hexdigest() != self.plan:
            raise UnisimError(
                f"{socket.gethostname()}: {self.store.where(PLAN_NAME)} is not this batch's; write to a folder that all "
                "machines share, or to an object store"
            )
        return Worker(self.store).run


@dataclass
class Worker:
    """Runs units one after another, and keeps the scene that the last one loaded."""

    store: Store
    _loaded: tuple[str, Renderer] | None = None
    loaded: list[str] = field(default_factory=list)
    """The keys of the scenes that were loaded, in order."""

    def run(self, unit: Unit) -> UnitRecord:
        """Run a unit: store what it makes, then its record, which is returned. Raises `UnisimError`."""
        with copies_used(unit.inputs), single_threaded(), tempfile.TemporaryDirectory(prefix="unisim-batch-") as folder:
            if isinstance(unit, RolloutUnit):
                record = self._rollout(unit, Path(folder))
            elif isinstance(unit, FormatsUnit):
                record = self._formats(unit, Path(folder))
            else:
                record = self._captures(unit, Path(folder))
        write_unit_record(self.store, record, records_of(unit))
        return record

    def _formats(self, unit: FormatsUnit, folder: Path) -> UnitRecord:
        out, files = folder / "run", Files()
        for path in write_formats(unit, self.store, out):
            files |= self._stored(path, f"{VARIANTS}/{unit.variant}/{path.relative_to(out).as_posix()}")
        return UnitRecord(unit.name, files=files)

    def _captures(self, unit: CaptureUnit, folder: Path) -> UnitRecord:
        captures: dict[str, CaptureEntry] = {}
        # labels need no renderer
        render = capture_renderer(unit.plan, self.renderer(unit.plan)) if unit.captures else _nothing
        for item in unit.work:
            captures |= self._moment(unit.plan, render, folder, item)
        return UnitRecord(unit.name, dict(sorted(captures.items())))

    def _moment(
        self, plan: RenderPlan, render: StartCapture, folder: Path, item: MomentWork
    ) -> dict[str, CaptureEntry]:
        """Render and store what a unit makes of a moment; its entries by identity."""
        if item.labels is None:
            formats = tuple(name for name in plan.settings.formats if name != "labels")
            plan = replace(plan, settings=replace(plan.settings, formats=formats))
        render_moment(plan, render, folder, Work(item.moment, item.captures, {}))
        entries = {}
        for name, record in read_records(folder).get(item.moment.key, {}).items():
            identity = item.labels if name == LABELS else record.identity
            assert identity is not None
            files: Files = {}
            for file in record.files:
                files |= self._stored(folder / file, f"{CAPTURES}/{identity[:2]}/{identity}/{file}")
            entries[identity] = CaptureEntry(files, record.sees, record.samples)
        return entries

    def _stored(self, path: Path, name: str) -> Files:
        """Store a file and remove it; its entry."""
        data = path.read_bytes()
        self.store.write(name, data)
        path.unlink()
        return {name: StoredFile(hashlib.sha256(data).hexdigest(), len(data))}

    def renderer(self, plan: RenderPlan) -> Renderer:
        """Return a plan's renderer, the one that is held where its scene is the plan's. Raises `UnisimError`."""
        key = scene_key(plan)
        if self._loaded is None or self._loaded[0] != key:
            self._loaded = None  # two scenes may not fit
            self._loaded = key, plan.recipe.load()
            self.loaded.append(key)
        return self._loaded[1]

    def _rollout(self, unit: RolloutUnit, folder: Path) -> UnitRecord:
        from ..simulation.drivers import driver_named
        from ..simulation.rollout.run import complete
        from ..simulation.rollout.setup import open_simulation
        from ..simulation.rollout.steps import BASE_NAME, SCENARIO_NAME

        out = folder / "rollout"
        simulation = open_simulation(
            unit.scenario, out, unit.options, unit.asked, driver_named(unit.driver), load=self.renderer
        )
        done = complete(simulation, unit.options, write=partial(write_runs, unit.formats))
        place = f"{ROLLOUTS}/{unit.variant}"
        for name in (BASE_NAME, SCENARIO_NAME):
            self._rebase(out / name, f"{place}/{name}")
        files: Files = {}
        for path in sorted(out.rglob("*")):
            name = path.relative_to(out).as_posix()
            if path.is_file() and name != TIMINGS_NAME and not name.startswith(f"{STATE_FOLDER}/"):
                files |= self._stored(path, f"{place}/{name}")
        return UnitRecord(unit.name, files=files, scores=json.loads(json_bytes(done.scores)))

    def _rebase(self, path: Path, name: str) -> None:
        """Have a scenario's file name what it names from where it will lie."""
        place = self.store.folder
        moved = rebased(load_scenario(path), (place or path.parent) / name, absolute=place is None)
        save_scenario(moved, path)


def _nothing(capture: Capture) -> NoReturn:
    raise AssertionError(f"{capture}: there is nothing to render")


def records_of(unit: Unit) -> str:
    """Return the place of a unit's record."""
    return FORMATS if isinstance(unit, FormatsUnit) else RECORDS


def finished_record(store: Store, unit: Unit, sizes: dict[str, int]) -> UnitRecord | None:
    """Return the record of a unit that an earlier run finished, if all that it names is there as it was written."""
    record = read_unit_record(store, unit.name, records_of(unit))
    if record is None or record.unit != unit.name:
        return None
    whole = all(store.holds(name, file.sha256, file.bytes, sizes) for name, file in record.every_file().items())
    return record if whole else None


def write_formats(unit: FormatsUnit, store: Store, out: Path) -> list[Path]:
    """Write a variant's formats into a new folder ``out``, which then holds what `unisim render` leaves of it, too. Return the
    files of the formats alone. Raises `UnisimError`.

    Files that name images name those of the store, as seen from the variant's place in it.
    """
    images = _lay_out(unit, store, out)
    before = {path for path in out.rglob("*") if path.is_file()}
    for name in unit.formats:
        write_sequence(name, unit.plan, out, images)
    return sorted({path for path in out.rglob("*") if path.is_file()} - before)


def _lay_out(unit: FormatsUnit, store: Store, out: Path) -> dict[str, str]:
    """Put a variant's captures together; what they are called in the store, by their paths in ``out``."""
    called: dict[str, str] = {}
    for moment in unit.plan.moments:
        captures = {}
        for name, identity in unit.moments[moment.name].items():
            files = _copied(identity, unit.entries[identity], store, out)
            called |= {inside: f"../../{CAPTURES}/{identity[:2]}/{identity}/{inside}" for inside in files}
            entry = unit.entries[identity]
            captures[name] = CaptureRecord(identity, files, entry.sees, entry.samples)
        write_record(out, moment.key, captures, finished=True)
    write_drive(unit.plan, out)
    write_file(out / MANIFEST, json_bytes(make_manifest(unit.plan, out, {})))
    return called


def _copied(identity: str, entry: CaptureEntry, store: Store, out: Path) -> dict[str, str]:
    """Copy a capture's files; their digests by their paths in ``out``. Raises `OutputError` where one is not what was stored."""
    digests = {}
    for name, file in entry.files.items():
        data = store.read(name)
        if data is None or hashlib.sha256(data).hexdigest() != file.sha256:
            raise OutputError(f"{store.where(name)}: is not what was stored there; render it again with --resume")
        inside = name.removeprefix(f"{CAPTURES}/{identity[:2]}/{identity}/")
        write_file(out / inside, data)
        digests[inside] = file.sha256
    return digests
