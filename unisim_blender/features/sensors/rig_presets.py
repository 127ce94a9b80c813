"""Rig presets: a team's own cameras and LiDARs, saved, shared, and put on the vehicle of any drive."""

from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatVectorProperty, StringProperty

from ...bridge.importing.rig_presets import (
    bring_back,
    hidden_sensors,
    look_ahead,
    own_presets,
    preset_file,
    put_rig,
    rig_of,
    users_folder,
)
from ...bridge.objects.imported import drive_of, source_of
from ...bridge.window import Need, choose, object_mode, refresh, vehicle
from ...core.errors import UnisimError
from ...core.rigs import read_rig, write_rig
from ...editing.sensors.names import rig_contents
from ...editing.texts import translatable
from ...translations import localized, message
from ..operator_bases import Editing, Needing, reporting

MODES = (
    (
        "REPLACE",
        "Replace",
        "Instead of the sensors on the vehicle: recorded ones are hidden and can be restored, others go",
    ),
    ("ADD", "Add", "Beside the sensors that are there"),
)


def hidden(context: bpy.types.Context) -> Need:
    """Some sensor of the log is hidden or was deleted."""
    drive = drive_of(context.scene)
    return drive is not None and hidden_sensors(context.scene, drive), "All recorded sensors are there"


class UNISIM_OT_apply_rig(Editing, bpy.types.Operator):
    """Put a rig preset's cameras and LiDARs on the vehicle"""

    bl_label = "Apply Rig Preset"
    needs = (object_mode, vehicle)

    filepath: StringProperty(name="File", subtype="FILE_PATH", options={"HIDDEN", "SKIP_SAVE"})
    mode: EnumProperty(
        name="Sensors", description="What becomes of the sensors on the vehicle", items=MODES, options={"SKIP_SAVE"}
    )
    offset: FloatVectorProperty(
        name="Offset", description="All of the rig, along the vehicle: forward, left, up", subtype="XYZ_LENGTH",
        unit="LENGTH",
        options={"SKIP_SAVE"},
    )  # fmt: skip

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """Return the preset's description, or why it cannot be read."""
        try:
            rig = read_rig(Path(properties.filepath))
        except UnisimError as fault:
            return str(fault)
        count = localized(rig_contents(rig))
        return f"{count}. {rig.about}".removesuffix(".") if rig.about else count

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Read the file first: nothing is changed where it is not valid."""
        path = Path(self.filepath)
        rig, drive = read_rig(path), source_of(context.scene).drive
        new = put_rig(context.scene, drive, rig, self.mode == "REPLACE", tuple(self.offset))
        choose(context, *reversed(new))
        refresh(new)
        self.report(
            {"INFO"}, message("{name}: {sensors} put on the vehicle", name=path.stem, sensors=rig_contents(rig))
        )
        return {"FINISHED"}


class UNISIM_OT_save_rig(Needing, bpy.types.Operator):
    """Save the sensors on the vehicle as a rig preset."""

    bl_label = "Save Rig Preset"
    bl_description = (
        "Save the sensors on the vehicle as a rig preset of your own, "
        "a file that colleagues can put into their presets folder"
    )
    bl_options = {"REGISTER"}
    needs = (object_mode, vehicle)

    name: StringProperty(name="Name", description="The file's name in the presets folder", default="My rig")
    about: StringProperty(name="About", description="Notes for users: vehicle, calibration, date")
    overwrite: BoolProperty(
        name="Replace the preset of this name",
        description="Write over a preset of your own that has this name",
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_props_dialog(self)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the name; whether to replace a file is asked only where there is one."""
        self.layout.use_property_split = True
        self.layout.prop(self, "name")
        self.layout.prop(self, "about")
        if any(path.stem == self.name.strip() for path in own_presets()):
            self.layout.prop(self, "overwrite")

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        path = preset_file(self.name)
        if path.exists() and not self.overwrite:
            raise UnisimError(message("{path}: is there already: choose another name, or replace it", path=path))
        rig, left = rig_of(context.scene, source_of(context.scene).drive, self.about.strip())
        write_rig(rig, path)
        said = message("{sensors} saved to {path}", sensors=rig_contents(rig), path=path)
        if left:
            why = translatable("{saved}; left out, because they are no mounted cameras or beam tables: {names}")
            said = message(why, saved=said, names=", ".join(left))
        self.report({"INFO"}, said)
        return {"FINISHED"}


class UNISIM_OT_remove_rig(bpy.types.Operator):
    """Delete the file of a rig preset; sensors on vehicles are kept"""

    bl_label = "Remove Rig Preset"
    bl_options = {"REGISTER"}

    filepath: StringProperty(name="File", subtype="FILE_PATH", options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask first: undo brings no file back."""
        return context.window_manager.invoke_confirm(self, event)

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        path = Path(self.filepath)
        if path not in own_presets():
            raise UnisimError(message("{path}: is no rig preset in Blender's presets folders", path=path))
        try:
            path.unlink()
        except OSError as fault:
            self.report({"ERROR"}, message("{path}: cannot be deleted: {why}", path=path, why=fault.strerror))
            return {"CANCELLED"}
        self.report({"INFO"}, message("Removed {path}", path=path))
        return {"FINISHED"}


class UNISIM_OT_rig_folder(bpy.types.Operator):
    """Open the folder of your own rig presets: files that colleagues gave you go there"""

    bl_label = "Open Presets Folder"
    bl_options = {"REGISTER"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        return set(bpy.ops.wm.path_open(filepath=str(users_folder())))


class UNISIM_OT_restore_sensors(Editing, bpy.types.Operator):
    """Show recorded sensors again that a rig preset has hidden, and make those anew that were deleted"""

    bl_label = "Restore Recorded Sensors"
    needs = (object_mode, vehicle, hidden)

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Bring them back as they stood before they were hidden."""
        names = bring_back(context.scene, source_of(context.scene))
        look_ahead(context.scene)
        refresh(())
        self.report({"INFO"}, message("Restored {names}", names=", ".join(sorted(names))))
        return {"FINISHED"}
