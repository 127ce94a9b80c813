"""LiDAR points in the view, recorded and simulated, following the frame and the edits."""

import queue

import bpy
from bpy.app.handlers import persistent

from ..bridge.clock import Clock
from ..bridge.neighbours import lacking, sample_now, step_beside
from ..bridge.point_colours import RECORDED, SIMULATED
from ..bridge.points import hide_points, put_points, show_recorded
from ..bridge.sampling import frame_of
from ..bridge.snapshot import lidar_request
from ..bridge.source import source_of
from ..client import Client, Request, client
from ..core.errors import UnisimError
from ..preferences import device, interpreter
from ..registering import add, take_away

POLL_S = 0.1

waiting: dict[tuple[str, str], tuple[Client, Request]] = {}
"""Sweeps that were asked for, by scene and LiDAR."""


def ask_sweeps(scene: bpy.types.Scene) -> None:
    """Ask for a sweep of every LiDAR of the scene, as it is now."""
    source = source_of(scene)
    clock = Clock.of(source.drive).around(frame_of(scene))
    step_beside(scene, clock, lacking(scene, clock))
    sampled = sample_now(scene, bpy.context.evaluated_depsgraph_get(), clock)
    worker = client(interpreter())
    for lidar in sampled.of("LIDAR"):
        before = waiting.pop((scene.name, lidar.name), None)
        if before is not None:
            before[0].cancel(before[1])
        values = lidar_request(sampled, lidar, source, frame_of(scene))
        request = worker.ask("lidar", **values, quality=scene.unisim.quality, device=device())
        waiting[scene.name, lidar.name] = worker, request
    if bpy.app.background:
        while waiting:
            gather()
    elif not bpy.app.timers.is_registered(gather):
        bpy.app.timers.register(gather, first_interval=POLL_S)


def gather() -> float | None:
    """Show the sweeps that have come; as a timer of Blender's, until all have."""
    for key, (worker, request) in list(waiting.items()):
        try:
            event = request.events.get(timeout=POLL_S) if bpy.app.background else request.events.get_nowait()
        except queue.Empty:
            continue
        scene = bpy.data.scenes.get(key[0])
        if event["event"] == "arrays" and scene is not None:
            arrays = worker.arrays(event)
            put_points(scene, key[1], SIMULATED, arrays.pop("points"), arrays)
        else:
            del waiting[key]
            bpy.context.window_manager.unisim_task = event.get("text", "")
    return POLL_S if waiting else None


@persistent
def follow(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Show the points of the frame that is shown now; while a picture is rendered nothing changes."""
    about = scene.unisim
    if not (about.show_recorded or about.show_simulated) or bpy.app.is_job_running("RENDER"):
        return
    try:
        update(scene)
    except (UnisimError, OSError) as fault:
        bpy.context.window_manager.unisim_task = str(fault)


def update(scene: bpy.types.Scene) -> None:
    """Show what the scene's switches ask for. Raises `UnisimError`."""
    for kind, wanted in ((RECORDED, scene.unisim.show_recorded), (SIMULATED, scene.unisim.show_simulated)):
        if not wanted:
            hide_points(scene, kind)
    if scene.unisim.show_recorded:
        show_recorded(scene, source_of(scene), scene.frame_current)
    if scene.unisim.show_simulated:
        ask_sweeps(scene)


class UNISIM_OT_show_points(bpy.types.Operator):
    """Show LiDAR points as they were recorded, as they are simulated, or both"""

    bl_idname = "unisim.show_points"
    bl_label = "Show LiDAR Points"
    bl_options = {"REGISTER", "UNDO"}

    recorded: bpy.props.BoolProperty(name="Recorded", default=True)
    simulated: bpy.props.BoolProperty(name="Simulated", default=False)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A drive has to be there."""
        return bool(context.scene.unisim.log)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Set the scene's switches and show."""
        scene = context.scene
        scene.unisim.show_recorded, scene.unisim.show_simulated = self.recorded, self.simulated
        try:
            update(scene)
        except (UnisimError, OSError) as fault:
            self.report({"ERROR"}, str(fault))
            return {"CANCELLED"}
        return {"FINISHED"}


CLASSES = (UNISIM_OT_show_points,)


def register() -> None:
    """Add the operator, and follow frames."""
    add(CLASSES)
    bpy.app.handlers.frame_change_post.append(follow)


def unregister() -> None:
    """Take them away."""
    if follow in bpy.app.handlers.frame_change_post:
        bpy.app.handlers.frame_change_post.remove(follow)
    if bpy.app.timers.is_registered(gather):
        bpy.app.timers.unregister(gather)
    waiting.clear()
    take_away(CLASSES)
