"""The ego vehicle: its trajectory displaced, and ordinary objects as its body."""

import bpy
from bpy.props import EnumProperty, FloatProperty, StringProperty

from ..bridge.changes.motion import displaced_along
from ..bridge.objects.ego_bodies import make_body, release_body
from ..bridge.objects.imported import imported_objects
from ..bridge.objects.meshes import parts
from ..bridge.window import allowed, choose, chosen, object_mode, refresh, selected, vehicle
from ..core.errors import UnisimError
from ..core.scenario.edits.ego_body import DEFAULT_LABEL
from ..translations import message
from .actors.operators import DIRECTIONS, marked_above
from .operator_bases import Needing, reporting
from .sidebar import DrivePanel, row_of


class UNISIM_OT_shift_ego(Needing, bpy.types.Operator):
    """Displace the trajectory of the ego vehicle and its sensors to the left or right"""

    bl_label = "Shift Ego Lane"
    bl_options = {"REGISTER", "UNDO"}
    needs = (object_mode, vehicle)

    left_m: FloatProperty(
        name="Left",
        description="Displacement to the left; negative values displace to the right",
        default=1.0,
        unit="LENGTH",
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        vehicles = list(imported_objects(context.scene, "EGO"))
        for ego in vehicles:
            displaced_along(ego, (0.0, self.left_m, 0.0))
        refresh(vehicles)
        return {"FINISHED"}


PLACES = (
    ("VEHICLE", "On the vehicle", "Pointing ahead, on the height of the vehicle's origin, its rear 1 m behind that"),
    ("HERE", "Current Location", "Keep the current location, as part of the vehicle from this frame on"),
)


class UNISIM_OT_ego_body(Needing, bpy.types.Operator):
    """Use the selected mesh objects and their children as the body of the ego vehicle, which sensors on it do not see"""

    bl_label = "Use as Ego Body"
    bl_options = {"REGISTER", "UNDO"}
    needs = (object_mode, vehicle, selected("Select a mesh object that is not part of the drive yet", "NONE"))

    place: EnumProperty(name="Place", description="Where the body goes", items=PLACES)
    forward: EnumProperty(name="Points along", description="Axis of the object that points ahead", items=DIRECTIONS)
    label: StringProperty(
        name="Class", description="As the log's labels have it: Car, Pickup Truck, Bus …", default=DEFAULT_LABEL
    )

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        meshes = [obj for obj in chosen(context, "NONE") if not marked_above(obj) and any(parts(obj))]
        if not meshes:
            raise UnisimError(message("no selected object has a surface"))
        moving = next((obj for obj in meshes if obj.animation_data is not None or obj.constraints), None)
        if moving is not None:
            raise UnisimError(
                message(
                    'object "{name}": has keys or constraints, and a body is fixed to the vehicle: clear them',
                    name=moving.name,
                )
            )
        meshes.sort(key=lambda obj: obj == context.active_object)
        body = make_body(context.scene, meshes, self.label or DEFAULT_LABEL, self.forward, self.place == "VEHICLE")
        choose(context, body)
        refresh([body])
        self.report({"INFO"}, message("{name} is the ego vehicle's body", name=body.name))
        return {"FINISHED"}


class UNISIM_OT_release_ego_body(bpy.types.Operator):
    """Turn the selected ego bodies, or all if none is selected, back into ordinary objects, which no sensor sees"""

    bl_label = "Release Ego Body"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        there = any(obj.unisim.kind == "BODY" for obj in context.scene.objects)
        return allowed(
            cls, object_mode(context), (there, "No mesh is the ego vehicle's body: Use as Ego Body makes one")
        )

    def execute(self, context: bpy.types.Context) -> set[str]:
        every = [obj for obj in context.scene.objects if obj.unisim.kind == "BODY"]
        released = [obj for obj in every if obj.select_get()] or every
        for obj in released:
            release_body(obj)
        refresh(released)
        return {"FINISHED"}


class UNISIM_PT_ego(DrivePanel, bpy.types.Panel):
    """The vehicle that recorded the drive"""

    bl_label = "Ego"
    bl_order = 6
    tasks = ("EDIT",)
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        bodies = [obj.name for obj in context.scene.objects if obj.unisim.kind == "BODY"]
        column = self.layout.column(align=True)
        row_of(column, "Body", ", ".join(bodies), "AUTO")
        column.operator("unisim.ego_body", icon="MESH_MONKEY")
        column.operator("unisim.release_ego_body", icon="X")
        self.layout.operator("unisim.shift_ego", icon="ARROW_LEFTRIGHT")
