"""File > Export > Scenario: what the scene stands for, as a file that renders headless."""

from __future__ import annotations

from collections.abc import Callable, Generator
from pathlib import Path

import bpy
from bpy.props import StringProperty
from bpy_extras.io_utils import ExportHelper

from ...bridge.objects.imported import source_of
from ...bridge.objects.settings import captures_stated, models_of, rollout_folder, with_simulation
from ...bridge.sampling.from_keys import sample_steps
from ...bridge.sampling.stepping import sample_all
from ...bridge.window import drive
from ...core.scenario.types import FRAME_FORMATS, SEQUENCE_FORMATS, FrameRange, Outputs, Scenario
from ...editing.reading.scenario import read_scenario, with_stated, write_scenario
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import Sampled
from ...editing.simulation.continued import as_driven, open_driven
from ...editing.simulation.rollouts import SCENARIO
from ...translations import message
from ..operator_bases import Editing, InSteps, Needing, in_thread
from .properties import PASSES


def scenario_of(scene: bpy.types.Scene, path: Path, start_s: float | None = None) -> Scenario:
    """The scenario that a Blender scene stands for, as it would be written to ``path``. A rollout's scene is as driven
    up to ``start_s``, see `continued.as_driven`. Raises `UnisimError`, also where a rollout's file is needed and is not there."""
    return _reader_of(scene, path, start_s)(sample_all(scene, Clock.of(source_of(scene).drive)))


def scenario_steps(
    scene: bpy.types.Scene, path: Path, start_s: float | None = None
) -> Generator[str | None, None, Scenario]:
    """Return, after some steps, what `scenario_of` returns; each step yields what the status bar says. The scene must
    not change between steps. Raises `UnisimError`."""
    read = _reader_of(scene, path, start_s)
    sampled = yield from sampled_in_steps(scene, Clock.of(source_of(scene).drive))
    return (yield from in_thread(lambda: read(sampled)))


def _reader_of(scene: bpy.types.Scene, path: Path, start_s: float | None) -> Callable[[Sampled], Scenario]:
    """Return what makes the scenario of a sampled scene, in any thread: what the scene stores beside its objects is read here."""
    source, (frames, outputs) = source_of(scene), _settings(scene)
    text, captures = scene.unisim.stated, captures_stated(scene)
    simulation, models, folder = scene.unisim_simulation.document, models_of(scene), rollout_folder(scene)

    def read(sampled: Sampled) -> Scenario:
        scenario = with_stated(read_scenario(sampled, source, path, frames, outputs), text, source.drive, captures)
        if folder is not None and (start_s is not None or (folder / SCENARIO).exists()):
            scenario = as_driven(scenario, source, open_driven(folder / SCENARIO, source), start_s)
        return with_simulation(scenario, simulation, models, source.drive)

    return read


def sampled_in_steps(scene: bpy.types.Scene, clock: Clock) -> Generator[str | None, None, Sampled]:
    """Return, after some steps, what `sample_all` returns."""
    steps = sample_steps(scene, clock)
    while True:
        try:
            done, total = next(steps)
        except StopIteration as end:
            return end.value
        yield message("Reading {scene}: {done} of {total} (Esc to cancel)", scene=scene.name, done=done, total=total)


def _settings(scene: bpy.types.Scene) -> tuple[FrameRange | None, Outputs]:
    """The frames of a scenario, None for all of the log's, and its outputs."""
    clock, settings = Clock.of(source_of(scene).drive), scene.unisim
    frames = clock.frame_range(scene.frame_start, scene.frame_end, scene.frame_step)
    passes = ("rgb", *(name for name, *_ in PASSES if name in settings.passes))
    formats = tuple(name for name in (*FRAME_FORMATS, *SEQUENCE_FORMATS) if name in settings.formats)
    return frames, Outputs(
        passes=passes,
        formats=None if formats == tuple(FRAME_FORMATS) else formats,
        quality=settings.quality,
        contact_shadows=settings.contact_shadows or None,
        fill=settings.fill if settings.fill != "none" else None,
        detail=settings.detail or None,
    )


class UNISIM_OT_export_scenario(Needing, InSteps, bpy.types.Operator, ExportHelper):
    """Write the edits of the scene to a scenario file for the command unisim render"""

    bl_label = "Export Scenario"
    bl_options = {"REGISTER"}
    needs = (drive,)

    filename_ext = ".json"
    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.by_hand = True
        return ExportHelper.invoke(self, context, event)

    def work(self, context: bpy.types.Context) -> Generator[str | None, None, None]:
        path = Path(self.filepath).absolute()
        scenario = yield from scenario_steps(context.scene, path)
        yield from in_thread(lambda: write_scenario(scenario, path))
        self.report(
            {"INFO"}, message("Scenario written to {path} (edits: {count})", count=len(scenario.edits), path=path)
        )


class UNISIM_OT_use_frame_range(Editing, bpy.types.Operator):
    """Render and export the frame range of the scene in place of the frames or times that the imported scenario states"""

    bl_label = "Use Frame Range"
    needs = (
        drive,
        lambda context: (captures_stated(context.scene), "The frame range is what is rendered already"),
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.scene.unisim.stated_range = (0, -1, 0)
        return {"FINISHED"}


def draw_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """A line in File > Export."""
    self.layout.operator("unisim.export_scenario", text="UniSim Scenario (.json)")


MENUS = ((bpy.types.TOPBAR_MT_file_export, draw_menu),)
