"""File > Import: drives, trained scenes, scenarios and rollouts, chosen or dropped onto the window."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any, TypeVar

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ...bridge.changes.applying import apply_edits
from ...bridge.changes.variants import delete_variant, show_variant
from ...bridge.importing.drive import import_source, recorded_colours, set_colours
from ...bridge.objects.imported import has_drive, skipped_sensors, source_of
from ...bridge.objects.lamps import put_lamps
from ...bridge.views.rollouts import actor_names, keep_rollout, mark_rollout, scene_of_rollout
from ...bridge.window import areas, drive, fit_camera_view, object_mode, show_tab
from ...core.errors import UnisimError
from ...core.formats.boxes import with_boxes
from ...core.formats.readers import READERS, drive_in, suffixes
from ...core.meshes.read import mesh_notes
from ...core.model.scene_file import HEADER_NAME, read_scene_header
from ...core.scenario import apply_scenario, load_scenario
from ...core.scenario.types import Scenario
from ...core.tracks.box_file import SUFFIX
from ...core.world.drive import Drive
from ...editing.sampled.clock import Clock
from ...editing.sampled.source import (
    DriveSource,
    ImportOptions,
    Recognised,
    is_rollout,
    lamps_of,
    open_source,
    recognised,
    scene_actors,
    summary,
)
from ...editing.simulation.rollouts import (
    SCENARIO,
    RolloutTimes,
    folder_of,
    moments_of,
    read_rollout,
    read_scores,
    rollout_state,
)
from ...editing.texts import counted, series, translatable
from ...preferences import default_folder
from ...translations import interface, localized, message
from ...viewport.view_types import follow_soon
from ..operator_bases import Editing, InSteps, Needing, in_thread
from ..problems import fail
from ..sidebar import Sidebar, settings_column

FAR_M = 2000.0
"""Clipping distance of views, in metres: a drive is longer than Blender's 100 m."""
TAB_DRAWINGS = 10
"""Number of steps in which the sidebar should have been drawn."""
MOST_CHOICES = 30
"""Number of drives in a folder that a menu shows."""
T = TypeVar("T")


class _ImportDrive(InSteps, ImportHelper):
    """Base of all importers: a progress bar, and one undo step at the end. Esc takes back what was imported."""

    begun = False
    """Whether something was imported."""

    def opening(self) -> Callable[[], DriveSource]:
        """Return what opens the drive; it runs in a thread."""
        raise NotImplementedError

    def invoke(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for what to import, unless it was dropped onto the window."""
        if self.filepath:
            return self.in_steps(context)
        self.filepath = default_folder("logs")
        return self.ask_for_path(context)

    def work(self: Any, context: bpy.types.Context) -> Generator[str | None, None, None]:
        source = yield from opened(self.opening())
        yield from self.bring_in(context, source)
        self.report({"INFO"}, localized(summary(source, skipped_sensors(context.scene))))

    def bring_in(self: Any, context: bpy.types.Context, source: DriveSource) -> Generator[str | None, None, None]:
        """Import an opened drive, and look through its camera where it is the scene's first."""
        first, manager = not has_drive(context.scene), context.window_manager
        first_in_file = not any(scene.unisim.log for scene in bpy.data.scenes)
        if self.timer is not None:
            manager.progress_begin(0, 100)
        for step in import_source(context.scene, source, self.parts()):
            self.begun = True
            if self.timer is not None:
                manager.progress_update(100 * step.done / step.total)
            values = {"what": step.what, "done": step.done, "total": step.total}
            yield message("Importing {what}: {done} of {total} (Esc to cancel)", **values)
            if step.draw:
                yield None
        if first:
            look_through_camera()
            if out := default_folder("output"):
                context.scene.unisim.out = str(Path(out, source.log_path.name.removesuffix(SUFFIX)))
        context.scene.unisim.first_steps |= first_in_file
        lamps = yield from in_thread(lambda: lamps_of(source, again=True))
        put_lamps(context.scene, lamps or {})
        if first and self.timer is not None:
            yield from show_drive(context, first_in_file)

    def parts(self) -> ImportOptions:
        """Return which parts of the drive to import."""
        return ImportOptions()

    def modal(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Some more steps. Without global undo nothing could take back what has come in, so that Esc is not heard."""
        if event.type == "ESC" and not context.preferences.edit.use_global_undo:
            return {"RUNNING_MODAL"}
        return InSteps.modal(self, context, event)

    def stopped(self: Any, context: bpy.types.Context, fault: bool) -> None:
        context.window_manager.progress_end()
        if self.begun and context.preferences.edit.use_global_undo:
            take_back()
        if not fault:
            self.report({"WARNING"}, message("Import cancelled: the scene is unchanged"))

    def finished(self: Any, context: bpy.types.Context) -> None:
        """Add the undo step. Blender itself would add one as soon as the file browser is closed, before
        anything is imported."""
        context.window_manager.progress_end()
        bpy.ops.ed.undo_push(message=self.bl_label)


def opened(todo: Callable[[], T]) -> Generator[str | None, None, T]:
    """Return what a function returns that opens a drive, in a thread."""
    yield message("Opening the drive (Esc to cancel)")
    return (yield from in_thread(todo))


def look_through_camera() -> None:
    """Show the drive through its camera in every 3D view; there is none without a window."""
    for area in areas("VIEW_3D"):
        space = area.spaces.active
        space.clip_end = max(space.clip_end, FAR_M)
        if space.region_3d is not None and is_sensor(bpy.context.scene.camera):
            space.region_3d.view_perspective = "CAMERA"
    follow_soon()


def show_drive(context: bpy.types.Context, open_tab: bool) -> Iterator[None]:
    """Let the camera's image fill the largest 3D view, in some steps; ``open_tab``: beside the sidebar's tab UniSim."""
    views = [area for area in context.window.screen.areas if area.type == "VIEW_3D"]
    area = max(views, key=lambda area: area.width * area.height, default=None)
    if area is None or area.spaces.active.region_3d is None or not is_sensor(context.scene.camera):
        return
    for _ in range(TAB_DRAWINGS if open_tab else 0):
        if show_tab(area, Sidebar.bl_category):
            break
        yield None
    yield None  # the sidebar gets its width when it is drawn
    fit_camera_view(area)


def is_sensor(camera: bpy.types.Object | None) -> bool:
    """Return whether a camera is one of the vehicle's."""
    return camera is not None and camera.unisim.kind == "CAMERA"


def take_back() -> None:
    """Put the file back to where it stood at the last undo step: half a drive would be read as one
    with actors removed."""
    bpy.ops.ed.undo_push(message="Half an import")
    bpy.ops.ed.undo()
    bpy.ops.ed.undo_push(message="Import Stopped")  # nor can a redo bring the half back


class _ImportsParts:
    """Base of importers of recorded drives: which parts of the drive to import."""

    sensors: StringProperty(
        name="Sensors",
        description="Names of the cameras and LiDARs to import, with commas between; * stands for any letters",
        default="*",
        options={"SKIP_SAVE"},
    )
    boxes: StringProperty(
        name="Boxes",
        description="File of boxes in place of the log's own; a trained scene has those that it was trained on",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )
    all_frames: BoolProperty(
        name="All Frames", description="Frame range of the whole drive", default=True, options={"SKIP_SAVE"}
    )
    first_frame: IntProperty(name="First", description="First frame", min=0, options={"SKIP_SAVE"})
    last_frame: IntProperty(
        name="Last", description="Last frame, or that of the drive", default=99, min=0, options={"SKIP_SAVE"}
    )
    frame_step: IntProperty(
        name="Step", description="Distance of frames that are rendered", default=1, min=1, options={"SKIP_SAVE"}
    )

    def draw(self: Any, context: bpy.types.Context) -> None:
        column = settings_column(self.layout)
        column.label(text="Of a drive or trained scene:")
        column.prop(self, "sensors")
        column.prop(self, "boxes")
        column.prop(self, "all_frames")
        frames = column.column(align=True)
        frames.enabled = not self.all_frames
        for name in ("first_frame", "last_frame", "frame_step"):
            frames.prop(self, name)

    def parts(self: Any) -> ImportOptions:
        """Return which parts; what was imported before where nothing is set."""
        names = None
        if self.properties.is_property_set("sensors"):
            names = tuple(filter(None, (name.strip() for name in self.sensors.split(","))))
        return ImportOptions(names, None if self.all_frames else (self.first_frame, self.last_frame, self.frame_step))

    def set_parts(self: Any) -> dict[str, Any]:
        """Return the properties that were set, by name."""
        names = ("sensors", "boxes", "all_frames", "first_frame", "last_frame", "frame_step")
        return {name: getattr(self, name) for name in names if self.properties.is_property_set(name)}


class UNISIM_OT_import_log(_ImportsParts, _ImportDrive, bpy.types.Operator):
    """Import the vehicle, sensors and actors of a recorded drive as animated objects"""

    bl_label = "Import Driving Log"
    bl_options = {"REGISTER", "INTERNAL"}

    directory: StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})
    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_folder: BoolProperty(default=True, options={"HIDDEN"})

    def opening(self) -> Callable[[], DriveSource]:
        chosen = Path(self.filepath or self.directory)
        boxes = Path(bpy.path.abspath(self.boxes)) if self.boxes else None
        return lambda: open_source(str(drive_in(chosen) if boxes is None else with_boxes(chosen, boxes)), "")


class UNISIM_OT_import_scene(_ImportsParts, _ImportDrive, bpy.types.Operator):
    """Import a trained neural scene and its drive, with refined tracklets"""

    bl_label = "Import Trained Neural Scene"
    bl_options = {"REGISTER", "INTERNAL"}

    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})

    def opening(self) -> Callable[[], DriveSource]:
        chosen = Path(self.filepath)
        folder = chosen.parent if chosen.name == HEADER_NAME else chosen
        if self.boxes:
            raise UnisimError(message("{folder}: shows the boxes that it was trained on, not others", folder=folder))
        return lambda: open_source(str((folder / read_scene_header(folder).log_path).resolve()), str(folder))


class _ImportScenario(_ImportDrive):
    """Base of importers of a scenario's drive; that of a rollout gets markers, too."""

    def bring_in_edited(
        self: Any, context: bpy.types.Context, imported: ImportedScenario
    ) -> Generator[str | None, None, None]:
        """Import an opened scenario's drive, then edit it."""
        scenario, source, edited, driven = imported
        yield from self.bring_in(context, source)
        for _ in apply_edits(context.scene, source, scenario, edited):
            yield message("Applying the edits (Esc to cancel)")
        if driven is not None:
            show_rollout(context.scene, scenario.path.parent, driven, Clock.of(source.drive))
        meshes = {actor.appearance.mesh for actor in edited.actors.values() if actor.appearance.mesh}
        for note in (note for mesh in sorted(meshes) for note in mesh_notes(Path(mesh))):
            self.report({"WARNING"}, note)
        edits = counted(len(scenario.edits), "1 edit", "{count} edits")
        self.report({"INFO"}, localized(series([summary(source), edits], "; ")))


class UNISIM_OT_import_scenario(_ImportScenario, bpy.types.Operator):
    """Import the drive of a scenario with all its edits"""

    bl_label = "Import Scenario"
    bl_options = {"REGISTER", "INTERNAL"}

    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})

    def work(self: Any, context: bpy.types.Context) -> Generator[str | None, None, None]:
        path = Path(self.filepath).absolute()
        scenario = yield from opened(lambda: opened_scenario(path))
        if has_drive(context.scene):
            raise UnisimError(
                f'scene "{context.scene.name}": has a drive already; import the scenario into a new scene'
            )
        yield from self.bring_in_edited(context, scenario)


class UNISIM_OT_open_rollout(Needing, _ImportScenario, bpy.types.Operator):
    """Open a rollout's folder: the drive as driven, its collisions as markers, the plans of its driver"""

    bl_label = "Open Rollout"
    bl_options = {"REGISTER"}
    needs = (object_mode,)

    directory: StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})
    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_folder: BoolProperty(default=True, options={"HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.in_steps(context) if self.filepath or self.directory else self.ask_for_path(context)

    def work(self: Any, context: bpy.types.Context) -> Generator[str | None, None, None]:
        """Open the rollout, and import its scenario; beside a drive that is there into a new variant."""
        folder = Path(bpy.path.abspath(self.filepath or self.directory)).absolute()
        if not is_rollout(folder):
            raise UnisimError(message("{folder}: holds no finished rollout", folder=folder))
        shown = scene_of_rollout(folder)
        if shown is not None and shown.unisim_simulation.state in ("", rollout_state(folder)):
            show_variant(context.window, shown)
            self.report({"INFO"}, message("{name} is shown: it was opened before", name=shown.name))
            return
        scenario = yield from opened(lambda: opened_scenario(folder / SCENARIO))
        if has_drive(context.scene):
            self.begun = True
            scene = bpy.data.scenes.new(folder.name)
            keep_settings(context.scene, scene)
            context.window.scene = scene
            yield None
        yield from self.bring_in_edited(context, scenario)
        if shown is not None:  # its folder has changed
            name = shown.name
            delete_variant(shown)
            context.scene.name = name


ImportedScenario = tuple[Scenario, DriveSource, Drive, RolloutTimes | None]
"""A scenario, its drive as it was recorded and as it is edited, and the rollout that left it, if one did."""


def opened_scenario(path: Path) -> ImportedScenario:
    """Open a scenario and what it is of. Raises `UnisimError`."""
    scenario = load_scenario(path)
    source = open_source(str(scenario.log_path), str(scenario.scene_path or ""))
    driven = None if folder_of(path) is None else read_rollout(path.parent)
    return scenario, source, apply_scenario(scenario, source.drive, scene_actors), driven


def show_rollout(scene: bpy.types.Scene, folder: Path, rollout: RolloutTimes, clock: Clock) -> None:
    """Mark in an imported scene what happened in its rollout."""
    try:
        moments = moments_of(read_scores(folder), actor_names(scene))
    except UnisimError:  # it was stopped before it was scored
        moments = []
    keep_rollout(folder, rollout)
    mark_rollout(scene, folder, rollout, [(moment, localized(moment.text)) for moment in moments], clock)


def keep_settings(before: bpy.types.Scene, new: bpy.types.Scene) -> None:
    """Give a new scene the settings of another that no scenario states: what drives, what renders, and where to."""
    for name in ("driver", "function", "address", "renderer", "out", "show_plans", "show_ghost"):
        setattr(new.unisim_simulation, name, getattr(before.unisim_simulation, name))
    for name in ("out", "sequence_sensors", "sequence_width"):
        setattr(new.unisim, name, getattr(before.unisim, name))
    new.world = before.world
    new.render.engine = before.render.engine  # a view would compile the shaders of Blender's own one, for ten seconds


class UNISIM_FH_json(bpy.types.FileHandler):
    """Files of drives, trained scenes, scenarios and rollouts, and rig presets, dropped onto the window"""

    bl_idname = "UNISIM_FH_json"
    bl_label = "UniSim"
    bl_import_operator = "unisim.import_drive"
    bl_file_extensions = ".json"  # and those of logs, which `register` adds

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        return context.area is not None and context.area.type in ("VIEW_3D", "OUTLINER")


class UNISIM_FH_image(bpy.types.FileHandler):
    """Recorded images dropped onto a window without a drive; Blender asks whether its own import is meant"""

    bl_idname = "UNISIM_FH_image"
    bl_label = "Drive of This Image"
    bl_import_operator = "unisim.import_drive"
    bl_file_extensions = ".jpg;.jpeg;.png"

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """As above, in a scene without a drive: in others images are what Blender makes of them."""
        return UNISIM_FH_json.poll_drop(context) and not context.scene.unisim.log


class UNISIM_OT_import_drive(_ImportsParts, bpy.types.Operator):
    """Import a recorded drive, a trained scene, a scenario or a rollout: its folder, a file of it, or the folder around it"""

    bl_label = "Import Drive"
    bl_options = {"REGISTER", "UNDO"}

    directory: StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE", "HIDDEN"})
    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.filepath:
            return self.execute(context)
        self.directory = default_folder("logs")
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Hand it to the operator that imports such a thing; ask which where a folder holds several."""
        path = Path(bpy.path.abspath(self.filepath or self.directory)).absolute()
        return handed_on(self, lambda: import_path(context, path, self.set_parts()))


def handed_on(operator: bpy.types.Operator, call: Callable[[], set[str]]) -> set[str]:
    """Return what another operator answers, whose errors are reported; what goes on has its own undo step."""
    try:
        answer = call()
    except RuntimeError as fault:  # what the other one reports
        return fail(operator, UnisimError(str(fault).removeprefix("Error: ").strip()))
    except (UnisimError, OSError) as fault:
        return fail(operator, fault)
    return {"INTERFACE"} if answer == {"RUNNING_MODAL"} else answer


def import_path(context: bpy.types.Context, path: Path, parts: dict[str, Any]) -> set[str]:
    """Import what a path is or holds; ask which where that is several. Raises `UnisimError`."""
    choices = recognised(path)
    if len(choices) == 1:
        return import_recognised(choices[0], parts)
    if bpy.app.background or context.window is None:
        names = ", ".join(choice.path.relative_to(path).as_posix() for choice in choices[:MOST_CHOICES])
        raise UnisimError(f"{path}: holds several; choose one: {names}")
    show_choices(context, path, choices, parts)
    return {"INTERFACE"}


def import_recognised(choice: Recognised, parts: dict[str, Any]) -> set[str]:
    """Call the operator that imports what was recognised, with the options of those that have any."""
    name, _, _ = KINDS[choice.kind]
    path = choice.path / HEADER_NAME if choice.kind == "scene" else choice.path
    how = "EXEC_DEFAULT" if choice.kind == "rig" else "INVOKE_DEFAULT"
    parts = parts if choice.kind in ("log", "scene") else {}
    return set(getattr(bpy.ops.unisim, name)(how, filepath=str(path), **parts))


KINDS = {
    "log": ("import_log", translatable("Drive"), "FILE_FOLDER"),
    "scene": ("import_scene", translatable("Trained Scene"), "SHADING_RENDERED"),
    "scenario": ("import_scenario", translatable("Scenario"), "FILE_TEXT"),
    "rollout": ("open_rollout", translatable("Rollout"), "ANIM"),
    "rig": ("apply_rig", translatable("Rig Presets"), "PRESET"),
}
"""Operators, names and icons of what is recognised."""


def show_choices(context: bpy.types.Context, folder: Path, choices: list[Recognised], parts: dict[str, Any]) -> None:
    """Show a menu of what a folder holds."""

    def draw(menu: bpy.types.Menu, _: bpy.types.Context) -> None:
        menu.layout.operator_context = "INVOKE_DEFAULT"
        for kind, path in choices[:MOST_CHOICES]:
            _, name, icon = KINDS[kind]
            text = f"{path.relative_to(folder).as_posix()} ({interface(name)})"
            entry = menu.layout.operator("unisim.import_drive", text=text, translate=False, icon=icon)
            for option, value in {**parts, "filepath": str(path)}.items():
                setattr(entry, option, value)

    context.window_manager.popup_menu(draw, title=interface("Import From {folder}", folder=folder.name), icon="IMPORT")


_items: list[tuple[str, str, str]] = []


def sensor_items(self: Any, context: bpy.types.Context) -> list[tuple[str, str, str]]:
    """Return the recorded sensors of the scene that is shown, as items of a property."""
    recorded = source_of(context.scene).drive if has_drive(context.scene) else None
    names = [] if recorded is None else [*recorded.cameras, *recorded.lidars]
    _items[:] = [(name, name, interface("Import {sensor}", sensor=name)) for name in names]  # Blender keeps no copy
    return _items


class UNISIM_OT_import_sensors(Needing, bpy.types.Operator):
    """Choose which recorded sensors are imported; edited ones stay"""

    bl_label = "Imported Sensors"
    bl_options = {"REGISTER"}
    needs = (object_mode, drive)

    sensors: EnumProperty(
        name="Sensors",
        description="Cameras and LiDARs to import",
        items=sensor_items,
        options={"ENUM_FLAG", "SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.sensors = {item[0] for item in sensor_items(self, context)} - skipped_sensors(context.scene)
        return set(context.window_manager.invoke_props_dialog(self, confirm_text="Import"))

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.column(align=True).prop(self, "sensors")

    def execute(self, context: bpy.types.Context) -> set[str]:
        about = context.scene.unisim
        kind, path = ("scene", about.scene) if about.scene else ("log", about.log)
        chosen, parts = Recognised(kind, Path(bpy.path.abspath(path))), {"sensors": ",".join(sorted(self.sensors))}
        return handed_on(self, lambda: import_recognised(chosen, parts))


class UNISIM_OT_locate_log(Editing, InSteps, bpy.types.Operator):
    """Choose the folder in which the log of this drive lies now"""

    bl_label = "Choose Folder of the Log"
    needs = (drive,)

    directory: StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.directory = default_folder("logs")
        return self.ask_for_path(context)

    def work(self, context: bpy.types.Context) -> Generator[str | None, None, None]:
        """Open it, and have all scenes of the drive name it. Raises `UnisimError` for another drive's log."""
        about, chosen = context.scene.unisim, Path(bpy.path.abspath(self.directory))
        scene = bpy.path.abspath(about.scene) if about.scene else ""
        source = yield from opened(lambda: open_source(str(drive_in(chosen)), scene))
        if about.origin and json.loads(about.origin) != source.drive.world_origin.tolist():
            raise UnisimError(message("{folder}: is the log of another drive", folder=source.log_path))
        before = about.log
        for other in bpy.data.scenes:
            if other.unisim.log == before:
                other.unisim.log = str(source.log_path)


class UNISIM_OT_recorded_colours(Editing, bpy.types.Operator):
    """Show colours as recorded: view transform Standard, look None, exposure 0, gamma 1"""

    bl_label = "Show Colours as Recorded"
    needs = (lambda context: (not recorded_colours(context.scene), "Colours are already shown as recorded"),)

    def execute(self, context: bpy.types.Context) -> set[str]:
        set_colours(context.scene)
        return {"FINISHED"}


def draw_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """A line in File > Import."""
    self.layout.operator_context = "INVOKE_DEFAULT"
    self.layout.operator("unisim.import_drive", text="Drive, Scene, Scenario or Rollout")


MENUS = ((bpy.types.TOPBAR_MT_file_import, draw_menu),)


def file_extensions() -> str:
    """Of files that can be dropped, as Blender wants them: of .tar.gz the last part, which is all that some versions
    look at."""
    return ";".join(
        sorted({".json", ".jsonl", ".safetensors", *(f".{suffix.rpartition('.')[2]}" for suffix in suffixes())})
    )


def register() -> None:
    """Look anew for readers of other packages: their files can be dropped, too."""
    importlib.invalidate_caches()  # the folder that they are in may not have been there when Blender started
    READERS.forget_plugins()
    UNISIM_FH_json.bl_file_extensions = file_extensions()
