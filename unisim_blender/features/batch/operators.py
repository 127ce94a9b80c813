"""Batches of the marked variants, rendered or driven, with parameters, in the background on this machine or on a
cluster."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
from bpy.props import EnumProperty, IntProperty

from ...bridge.changes.variants import variants_of
from ...bridge.objects.imported import source_of
from ...bridge.objects.settings import output_sensors
from ...bridge.window import Need, drive, folder_on_disk
from ...core.actor_images.names import plain_names
from ...core.errors import UnisimError
from ...core.scenario import scenario_to_json
from ...core.scenario.types import Scenario
from ...editing.edits.variants import file_names
from ...editing.simulation.menus import renderer_options
from ...editing.simulation.stated import as_simulated
from ...editing.simulation.sweeps import ScenarioField, fields_of, sweep_document, write_jobs
from ...editing.texts import free_name, translatable
from ...preferences import device, interpreter
from ...process.background import launch
from ...process.tasks import Task
from ...translations import localized, message
from ..drive.export_operators import scenario_of, scenario_steps
from ..operator_bases import Editing, Needing, in_thread, nothing_runs
from ..output.operators import sensor_options, width_options
from ..problems import fail
from ..simulation.operators import Simulates
from ..simulation.properties import driver_of
from ..variants.operators import marked_variants, variant_marked
from .properties import parameters_of


class BatchTask(Task):
    """Units of a batch, which the command line tells of as they end; its folder has the scenarios.

    Cancelled and submitted again, it goes on with the units that are missing.
    """

    title = translatable("Batch")
    hears = True
    units = translatable("{done} of {total} units")

    def __init__(self, arguments: list[str], folder: Path, chosen: str) -> None:
        super().__init__(arguments, folder, 0.0, chosen)
        self.reused = self.finished = self.failed = 0
        """Units that an earlier run had finished, that this one has, and that failed."""

    @property
    def done(self) -> float:
        return float(self.reused + self.finished + self.failed)

    def hear(self, event: dict[str, Any]) -> None:
        if event["event"] == "start":
            self.total, self.reused = float(event["units"]), event["kept"]
            self.before = self.done
        elif event["event"] == "unit" and event["failure"] is None:
            self.finished += 1
        elif event["event"] == "unit":
            self.failed += 1

    def measure(self) -> str:
        if not self.total:
            return message("Checking scenarios")
        units = super().measure()
        return units if not self.failed else message("{units}, {count} failed", units=units, count=self.failed)

    def speed(self, rate: float) -> str:
        return message(", {rate:.1f} units/min", rate=60 * rate)


REPORT = "report.html"
_fields: list[ScenarioField] = []
"""Fields that the menu offers; Blender does not keep what it shows."""
_items: list[tuple[str, str, str]] = []


def batch_place(scene: bpy.types.Scene) -> str:
    """Return the folder or URL that a scene's batch goes to; "" while it is not known."""
    out = scene.unisim_batch.out.strip()
    return str(out if "://" in out else folder_on_disk(out) or "")


def jobs_folder(scene: bpy.types.Scene) -> Path | None:
    """Return the folder of the scenarios and sweeps that a batch is made of: beside the batch, or beside the .blend
    where that goes to an object store. None while it is not known."""
    place = batch_place(scene)
    if place and "://" not in place:
        return Path(place).with_name(f"{Path(place).name} jobs")
    return Path(bpy.path.abspath("//batch jobs")).absolute() if place and bpy.data.filepath else None


def count_of(scene: bpy.types.Scene) -> int:
    """Return how many scenarios a batch has."""
    count = len(marked_variants(scene))
    for parameter in parameters_of(scene):
        count *= parameter.variants
    return count


def place_known(context: bpy.types.Context) -> Need:
    """The places of the batch and of its scenarios are known."""
    return jobs_folder(context.scene), "Save the .blend first, or choose a folder that does not depend on it"


def is_driven(context: bpy.types.Context) -> Need:
    """The driver is known, where one drives."""
    scene = context.scene
    named = not scene.unisim_batch.driven or bool(driver_of(scene))
    return named, "Name the driver first: module:function, or its address"


class UNISIM_OT_submit_batch(Needing, Simulates, bpy.types.Operator):
    """Render the marked variants with all values of the parameters, or drive through them, in the background"""

    bl_label = "Submit Batch"
    bl_options = {"REGISTER"}
    needs = (drive, variant_marked, place_known, is_driven, nothing_runs)

    def work(self: Any, context: bpy.types.Context) -> Generator[str | None, None, None]:
        scene = context.scene
        folder, place, about = jobs_folder(scene), batch_place(scene), scene.unisim_batch
        assert folder is not None  # the button is grey without
        driver = driver_of(scene) if about.driven else None
        arguments = ["--out", place, "--resume", "--json", *_options(scene, context.selected_objects, driver)]
        parameters, scenes = parameters_of(scene), variants_of(scene)
        names = file_names(variant.name for variant in scenes)
        read: dict[str, Scenario] = {}
        for variant in marked_variants(scene):
            path = folder / f"{names[variant.name]}.json"
            scenario = yield from scenario_steps(variant, path, self.start_of(variant) if driver else None)
            scenario = as_simulated(scenario) if driver else scenario
            read[names[variant.name]] = replace(scenario, name=variant.name, path=path)
        sweeps = {name: sweep_document(name, f"{name}.json", parameters, driver) for name in read} if parameters else {}
        jobs = yield from in_thread(lambda: write_jobs(read, sweeps, folder))
        launch(BatchTask(["batch", *map(str, jobs), *arguments], folder, interpreter()))


def _options(scene: bpy.types.Scene, selected: Any, driver: str | None) -> Iterator[str]:
    """Yield the options of the command."""
    about, simulation = scene.unisim_batch, scene.unisim_simulation
    yield from ("--on", (about.address.strip() or "ray") if about.executor == "ray" else about.executor)
    yield from ("--device", device())
    if about.jobs:
        yield from ("--jobs", str(about.jobs))
    yield from sensor_options(output_sensors(scene, selected, source_of(scene).drive))
    yield from width_options(scene)
    yield from renderer_options(simulation.renderer)
    if driver is not None:
        yield from ("--driver", driver)


def field_items(self: bpy.types.Operator, context: bpy.types.Context) -> list[tuple[str, str, str]]:
    """The fields of the scenario that a parameter may fill, for a menu with a search."""
    return _items or [("", "None", "")]


class UNISIM_OT_add_parameter(Editing, bpy.types.Operator):
    """Add a parameter: a field of the scenario that the batch fills with several values"""

    bl_label = "Add Parameter"
    bl_property = "at"
    needs = (drive,)

    at: EnumProperty(name="Field", description="Field of the scenario", items=field_items, options={"SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        try:
            find_fields(context.scene)
        except UnisimError as fault:
            return fail(self, fault)
        if not _fields:
            self.report({"WARNING"}, message("The scenario has no edit and no setting of a simulation to vary"))
            return {"CANCELLED"}
        context.window_manager.invoke_search_popup(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        field = next((other for other in _fields if other.pointer == self.at), None)
        if field is None:
            return {"CANCELLED"}
        parameters = context.scene.unisim_batch.parameters
        taken = {other.name for other in parameters}
        new = parameters.add()
        new.at, new.about = field.pointer, localized(field.label)
        new.name = free_name(new.about, taken)
        if isinstance(field.value, str):
            new.kind, new.values = "VALUES", field.value
        elif isinstance(field.value, int):
            new.kind, new.values = "VALUES", ", ".join(str(field.value + step) for step in range(new.count))
        else:
            new.start, new.stop = field.range
            new.values = f"{field.value:g}"
        return {"FINISHED"}


def find_fields(scene: bpy.types.Scene) -> None:
    """Read which fields the scenario of a scene has, for the menu. Raises `UnisimError`."""
    path = Path(bpy.path.abspath("//")).absolute() / "scenario.json"
    names = plain_names(source_of(scene).drive.actors)
    _fields[:] = fields_of(scenario_to_json(scenario_of(scene, path)), names)
    values = [field.value if isinstance(field.value, str) else f"{field.value:.4g}" for field in _fields]
    _items[:] = [
        (field.pointer, f"{localized(field.label)} = {value}", field.pointer)
        for field, value in zip(_fields, values, strict=True)
    ]


class UNISIM_OT_remove_parameter(bpy.types.Operator):
    """Remove this parameter"""

    bl_label = "Remove Parameter"
    bl_options = {"REGISTER", "UNDO"}

    index: IntProperty(options={"HIDDEN", "SKIP_SAVE"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.scene.unisim_batch.parameters.remove(self.index)
        return {"FINISHED"}


def report_path(scene: bpy.types.Scene) -> Path | None:
    """Return the report of a scene's batch; None where it has none on this machine."""
    place = batch_place(scene)
    path = Path(place) / REPORT
    return path if place and "://" not in place and path.is_file() else None


class UNISIM_OT_open_report(Needing, bpy.types.Operator):
    """Open the report of the batch in the browser: its variants with images, scores, and filters over parameters"""

    bl_label = "Open Report"
    bl_options = {"REGISTER"}
    needs = (
        drive,
        lambda context: (report_path(context.scene), "There is no report in the folder of the batch yet"),
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        path = report_path(context.scene)
        assert path is not None  # the button is grey without
        return bpy.ops.wm.url_open(url=path.as_uri())
