"""File > Import > Driving Log, and Trained Neural Scene."""

import time
from pathlib import Path

import bpy
from bpy.props import StringProperty
from bpy_extras.io_utils import ImportHelper

from ..bridge.applying import apply_edits
from ..bridge.importing import import_source, recorded_colours, set_colours, summary
from ..bridge.source import open_source
from ..bridge.things import has_drive
from ..bridge.windows import areas
from ..core.edits import apply_scenario
from ..core.errors import UnisimError
from ..core.json_file import read_json
from ..core.logs import is_pandaset
from ..core.prepare.scenario import scene_actors
from ..core.rigs import FORMAT as RIG_FORMAT
from ..core.scenario import FORMAT, load_scenario
from ..core.scene_file import HEADER_NAME, read_scene_header
from ..registering import add, take_away
from ..translations import message
from ..view_types import follow_soon
from .polling import allowed

FAR_M = 2000.0
"""How far a view shows what there is, in metres: a drive is longer than Blender's 100 m."""
BUSY_S = 0.05
"""How long the import works before it lets the window breathe."""


class _ImportDrive(ImportHelper):
    """What both importers share: steps between redraws, a progress bar, Esc."""

    bl_options = {"REGISTER", "UNDO"}

    def paths(self) -> tuple[str, str]:
        """The log's folder and the trained scene's, or ""."""
        raise NotImplementedError

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for what to import, unless it was dropped onto the window."""
        if self.filepath:
            return self.run(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def begin(self, context: bpy.types.Context) -> bool:
        """Open the drive; report and return False where that fails."""
        try:
            self.first = not has_drive(context.scene)
            self.source = open_source(*self.paths())
            self.steps = import_source(context.scene, self.source)
        except (UnisimError, OSError) as fault:
            self.report({"ERROR"}, str(fault))
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """All at once: from a script, or without a window."""
        if not self.begin(context):
            return {"CANCELLED"}
        for _ in self.steps:
            pass
        return self.done()

    def done(self) -> set[str]:
        """Show the drive and say what came in."""
        if self.first:
            look_through_camera()
        self.report({"INFO"}, summary(self.source))
        return {"FINISHED"}

    def run(self, context: bpy.types.Context) -> set[str]:
        """Step by step, behind a progress bar."""
        if context.window is None or bpy.app.background:
            return self.execute(context)
        if not self.begin(context):
            return {"CANCELLED"}
        context.window_manager.progress_begin(0, 100)
        self.timer = context.window_manager.event_timer_add(0.01, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Some steps at each tick of the timer."""
        if event.type == "ESC" and context.preferences.edit.use_global_undo:
            self.end(context)
            take_back()
            self.report({"WARNING"}, "Import cancelled: the scene is unchanged")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"RUNNING_MODAL"}
        until = time.monotonic() + BUSY_S
        for done, total, what in self.steps:
            context.window_manager.progress_update(100 * done / total)
            context.workspace.status_text_set(
                message("Importing {what}: {done} of {total} (Esc to cancel)", what=what, done=done, total=total)
            )
            if time.monotonic() > until:
                return {"RUNNING_MODAL"}
        self.end(context)
        return self.done()

    def end(self, context: bpy.types.Context) -> None:
        """Take progress and timer away."""
        context.window_manager.event_timer_remove(self.timer)
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)


def look_through_camera() -> None:
    """Show the drive through its camera in every 3D view; there is none without a window."""
    for area in areas("VIEW_3D"):
        space = area.spaces.active
        space.clip_end = max(space.clip_end, FAR_M)
        if space.region_3d is not None:
            space.region_3d.view_perspective = "CAMERA"
    follow_soon()


def take_back() -> None:
    """Put the file back to where it stood at the last undo step: half a drive would be read as one with actors removed."""
    bpy.ops.ed.undo_push(message="Half an import")
    bpy.ops.ed.undo()
    bpy.ops.ed.undo_push(message="Import Stopped")  # nor can a redo bring the half back


class UNISIM_OT_import_log(bpy.types.Operator, _ImportDrive):
    """Import the vehicle, sensors and actors of a recorded drive as animated objects"""

    bl_idname = "unisim.import_log"
    bl_label = "Import Driving Log"
    bl_options = {"REGISTER", "UNDO"}

    directory: StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})
    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_folder: bpy.props.BoolProperty(default=True, options={"HIDDEN"})

    def paths(self) -> tuple[str, str]:
        """The folder that was chosen."""
        return str(Path(self.filepath or self.directory)), ""


class UNISIM_OT_import_scene(bpy.types.Operator, _ImportDrive):
    """Import a trained neural scene and its drive, with refined tracklets"""

    bl_idname = "unisim.import_scene"
    bl_label = "Import Trained Neural Scene"
    bl_options = {"REGISTER", "UNDO"}

    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})

    def paths(self) -> tuple[str, str]:
        """The scene's folder, and the log that its header names."""
        chosen = Path(self.filepath)
        folder = chosen.parent if chosen.name == HEADER_NAME else chosen
        header = read_scene_header(folder)
        return str((folder / header.log_path).resolve()), str(folder)


class UNISIM_OT_import_scenario(bpy.types.Operator, ImportHelper):
    """Import the drive of a scenario with all its edits"""

    bl_idname = "unisim.import_scenario"
    bl_label = "Import Scenario"
    bl_options = {"REGISTER", "UNDO"}

    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Import the drive, then edit it."""
        try:
            scenario = load_scenario(Path(self.filepath))
            source = open_source(str(scenario.log_path), str(scenario.scene_path or ""))
            edited = apply_scenario(scenario, source.drive, scene_actors)
        except (UnisimError, OSError) as fault:
            self.report({"ERROR"}, str(fault))
            return {"CANCELLED"}
        if has_drive(context.scene):
            self.report({"ERROR"}, f'scene "{context.scene.name}": has a drive already; import the scenario into a new scene')
            return {"CANCELLED"}
        for _ in import_source(context.scene, source):
            pass
        apply_edits(context.scene, source, scenario, edited)
        look_through_camera()
        self.report({"INFO"}, f"{summary(source)}; {len(scenario.edits)} edits")
        return {"FINISHED"}


class UNISIM_FH_json(bpy.types.FileHandler):
    """Scenarios dropped onto the window"""

    bl_idname = "UNISIM_FH_json"
    bl_label = "UniSim"
    bl_import_operator = "unisim.import_dropped"
    bl_file_extensions = ".json"

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """Wherever a drive can be seen."""
        return context.area is not None and context.area.type in ("VIEW_3D", "OUTLINER")


def format_of(path: Path) -> str:
    """What a JSON file says that it is, "" where it says nothing."""
    try:
        document = read_json(path, UnisimError)
    except UnisimError:
        return ""
    return str(document.get("format", "")) if isinstance(document, dict) else ""


class UNISIM_OT_import_dropped(bpy.types.Operator):
    """Import the scenario, trained scene, log or rig preset that a dropped .json file belongs to"""

    bl_idname = "unisim.import_dropped"
    bl_label = "Import into UniSim"
    bl_options = {"REGISTER", "UNDO"}

    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Tell which of them it is by its name, or by the folders round it: the window gives files alone, a log is a folder."""
        path = Path(self.filepath)
        # a rendered sequence has its scenario beside a log's folders
        said = format_of(path)
        log = None if said in (FORMAT, RIG_FORMAT) else next((folder for folder in path.parents[:3] if is_pandaset(folder)), None)
        if said == RIG_FORMAT:
            operator, how = bpy.ops.unisim.apply_rig, "EXEC_DEFAULT"
        elif path.name == HEADER_NAME:
            operator, how = bpy.ops.unisim.import_scene, "INVOKE_DEFAULT"
        elif log is not None:
            operator, how, path = bpy.ops.unisim.import_log, "INVOKE_DEFAULT", log
        else:
            operator, how = bpy.ops.unisim.import_scenario, "EXEC_DEFAULT"
        try:
            answer = operator(how, filepath=str(path))
        except RuntimeError as fault:  # what the operator reports
            self.report({"ERROR"}, str(fault).removeprefix("Error: ").strip())
            return {"CANCELLED"}
        return {"INTERFACE"} if answer == {"RUNNING_MODAL"} else answer  # the operator that goes on has its own undo step

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """As dropped."""
        return self.execute(context)


class UNISIM_OT_recorded_colours(bpy.types.Operator):
    """Show colours as recorded: view transform Standard, look None, exposure 0, gamma 1"""

    bl_idname = "unisim.recorded_colours"
    bl_label = "Show Colours as Recorded"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Colours have to be shown otherwise."""
        return allowed(cls, (not recorded_colours(context.scene), "Colours are already shown as recorded"))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Set the scene's colour management."""
        set_colours(context.scene)
        return {"FINISHED"}


def draw_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Lines in File > Import."""
    self.layout.operator_context = "INVOKE_DEFAULT"
    self.layout.operator(UNISIM_OT_import_log.bl_idname, text="Driving Log (folder)")
    self.layout.operator(UNISIM_OT_import_scene.bl_idname, text="Trained Neural Scene (scene.json)")
    self.layout.operator(UNISIM_OT_import_scenario.bl_idname, text="UniSim Scenario (.json)")


CLASSES = (
    UNISIM_OT_import_log,
    UNISIM_OT_import_scene,
    UNISIM_OT_import_scenario,
    UNISIM_OT_import_dropped,
    UNISIM_OT_recorded_colours,
    UNISIM_FH_json,
)


def register() -> None:
    """Add the operators and their lines in the menu."""
    add(CLASSES)
    bpy.types.TOPBAR_MT_file_import.append(draw_menu)


def unregister() -> None:
    """Take them away."""
    bpy.types.TOPBAR_MT_file_import.remove(draw_menu)
    take_away(CLASSES)
