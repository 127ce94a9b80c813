"""The ego vehicle: its trajectory displaced, and ordinary objects as its body."""

import bpy
from bpy.props import EnumProperty, StringProperty

from ..bridge.changes.motion import displaced_along
from ..bridge.objects.ego_bodies import make_body, release_body
from ..bridge.objects.imported import imported_objects
from ..bridge.window import Need, choose, object_mode, selected, vehicle
from ..core.errors import UnisimError
from ..core.scenario.edits.ego_body import DEFAULT_LABEL
from ..translations import message
from .actors.operators import DIRECTIONS, selected_meshes
from .operator_bases import EditsObjects, in_metres
from .sidebar import DrivePanel, row_of


class UNISIM_OT_shift_ego(EditsObjects, bpy.types.Operator):
    """Displace the trajectory of the ego vehicle and its sensors to the left or right"""

    bl_label = "Shift Ego Lane"
    needs = (object_mode, vehicle)

    left_m: in_metres("Left", "Displacement to the left; negative values displace to the right", 1.0, once=False)

    def edit(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        vehicles = list(imported_objects(context.scene, "EGO"))
        for ego in vehicles:
            displaced_along(ego, (0.0, self.left_m, 0.0))
        return vehicles


def bodies_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the objects that are the ego vehicle's body."""
    return [obj for obj in scene.objects if obj.unisim.kind == "BODY"]


PLACES = (
    ("VEHICLE", "On the vehicle", "Pointing ahead, on the height of the vehicle's origin, its rear 1 m behind that"),
    ("HERE", "Current Location", "Keep the current location, as part of the vehicle from this frame on"),
)


class UNISIM_OT_ego_body(EditsObjects, bpy.types.Operator):
    """Use the selected mesh objects and their children as the body of the ego vehicle, which sensors on it do not see"""

    bl_label = "Use as Ego Body"
    needs = (object_mode, vehicle, selected("Select a mesh object that is not part of the drive yet", "NONE"))

    place: EnumProperty(name="Place", description="Where the body goes", items=PLACES)
    forward: EnumProperty(name="Points along", description="Axis of the object that points ahead", items=DIRECTIONS)
    label: StringProperty(
        name="Class", description="As the log's labels have it: Car, Pickup Truck, Bus …", default=DEFAULT_LABEL
    )

    def edit(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        meshes = selected_meshes(context)
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
        self.report({"INFO"}, message("{name} is the ego vehicle's body", name=body.name))
        return [body]


def ego_body(context: bpy.types.Context) -> Need:
    """The ego vehicle has a body."""
    return bodies_of(context.scene), "No mesh is the ego vehicle's body: Use as Ego Body makes one"


class UNISIM_OT_release_ego_body(EditsObjects, bpy.types.Operator):
    """Turn the selected ego bodies, or all if none is selected, back into ordinary objects, which no sensor sees"""

    bl_label = "Release Ego Body"

    needs = (object_mode, ego_body)

    def edit(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        every = bodies_of(context.scene)
        released = [obj for obj in every if obj.select_get()] or every
        for obj in released:
            release_body(obj)
        return released


class UNISIM_PT_ego(DrivePanel, bpy.types.Panel):
    """The vehicle that recorded the drive"""

    bl_label = "Ego"
    bl_order = 6
    tasks = ("EDIT",)
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        column = self.layout.column(align=True)
        row_of(column, "Body", ", ".join(obj.name for obj in bodies_of(context.scene)), "AUTO")
        column.operator("unisim.ego_body", icon="MESH_MONKEY")
        column.operator("unisim.release_ego_body", icon="X")
        self.layout.operator("unisim.shift_ego", icon="ARROW_LEFTRIGHT")
