"""LiDAR points in the view, recorded and simulated, following the frame and the edits."""

import queue
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any

import bpy
from bpy.app.handlers import persistent

from ...bridge.objects.imported import source_of
from ...bridge.sampling.adjacent_frames import lacking, sample_now, step_beside, with_lengths
from ...bridge.sampling.stepping import frame_of
from ...bridge.views.points import hide_points, put_sweep
from ...bridge.window import drive, redraw, run_soon
from ...core.errors import UnisimError
from ...core.world.drive import Lidar
from ...core.world.encoding import decode_sensor
from ...editing.reading.requests import lidar_request, without_unreadable
from ...editing.sampled.clock import Clock
from ...editing.sensors.sweeps import (
    DROPS,
    RECORDED,
    SIMULATED,
    ViewedSweep,
    recorded_sweeps,
    same_beams,
    simulated_sweeps,
)
from ...preferences import device, interpreter
from ...process.client import Client, Request, client, progress_line
from ...translations import localized
from ..operator_bases import Editing, reporting

POLL_S = 0.1
EDIT_S = 0.4
"""From a change of the scene to the sweeps of it: a box that is dragged asks for few of them."""
READ_S = 0.02
"""Between two looks whether recorded points have been read."""
reader = ThreadPoolExecutor(1, thread_name_prefix="unisim-points")
"""Reads one frame at a time."""
reading: dict[str, Future[list[ViewedSweep]]] = {}
"""Recorded points that are being read, by scene: those of the newest frame."""
waiting: dict[tuple[str, str], tuple[Client, Request, bool, float]] = {}
"""Sweeps that were asked for, by scene and LiDAR: whether their beams are the recorded ones, and the frame."""
asked: dict[tuple[str, str], dict[str, Any]] = {}
"""Values of the newest requests, by the same."""


def show_recorded(scene: bpy.types.Scene) -> None:
    """Show the recorded returns of the frame that is shown. In a window a thread reads them, and a timer
    shows them then."""
    wanted = source_of(scene), scene.frame_current, scene.unisim.show_drops or scene.unisim.show_simulated
    if bpy.app.background:
        for sweep in recorded_sweeps(*wanted):
            put_sweep(scene, sweep)
        return
    before = reading.pop(scene.name, None)
    if before is not None:
        before.cancel()
    reading[scene.name] = reader.submit(recorded_sweeps, *wanted)
    run_soon(show_read, READ_S)


def show_read() -> float | None:
    """Show what has been read; as a timer of Blender's, until all has."""
    if bpy.app.is_job_running("RENDER"):
        return POLL_S
    for name, future in list(reading.items()):
        if not future.done():
            continue
        del reading[name]
        scene = bpy.data.scenes.get(name)
        if scene is None or future.cancelled() or not scene.unisim.show_recorded:
            continue
        try:
            for sweep in future.result():
                put_sweep(scene, sweep)
        except (UnisimError, OSError) as fault:
            bpy.context.window_manager.unisim_points = str(fault)
        redraw("VIEW_3D")
    return READ_S if reading else None


def ask_sweeps(scene: bpy.types.Scene) -> None:
    """Ask for a sweep of every LiDAR of the scene, as it is now, unless just that was asked for last."""
    source = source_of(scene)
    clock = Clock.of(source.drive).around(frame_of(scene))
    step_beside(scene, clock, lacking(scene, clock))
    sampled = sample_now(scene, bpy.context.evaluated_depsgraph_get(), clock)
    sampled = with_lengths(sampled, scene, source.drive)
    worker = client(interpreter())
    for lidar in sampled.of("LIDAR"):
        key, recorded = (scene.name, lidar.name), source.drive.lidars.get(lidar.uid)
        if (recorded is not None and not recorded.model.beams) or not lidar.there.any():
            continue  # the log's plain points, or hidden for renders
        settings = {"quality": scene.unisim.quality, "device": device()}
        settings["fill"] = scene.unisim.fill
        ask = partial(lidar_request, lidar=lidar, source=source, frame=frame_of(scene))
        values, left_out = without_unreadable(ask, sampled, source.drive)
        values |= {**settings, "warnings": [*values["warnings"], *map(localized, left_out)]}
        if asked.get(key) == values:
            continue
        before = waiting.pop(key, None)
        if before is not None:
            before[0].cancel(before[1])
        asked[key] = values
        sensor = decode_sensor(values["sensor"])
        same = isinstance(sensor, Lidar) and same_beams(sensor, values["time_s"], source.drive, frame_of(scene))
        waiting[key] = worker, worker.ask("lidar", **values), same, frame_of(scene)
    while bpy.app.background and waiting:
        gather()
    run_soon(gather, POLL_S)


def gather() -> float | None:
    """Show the sweeps that have come; as a timer of Blender's, until all have."""
    for key, (worker, request, same, frame) in list(waiting.items()):
        try:
            event = request.events.get(timeout=POLL_S) if bpy.app.background else request.events.get_nowait()
        except queue.Empty:
            continue
        scene = bpy.data.scenes.get(key[0])
        if event["event"] == "progress":
            bpy.context.window_manager.unisim_points = progress_line(event)
            continue
        if event["event"] == "warning":
            print(f"Warning: {event['text']}")
            continue
        if event["event"] == "arrays" and scene is not None:
            arrays, beams, actors = worker.arrays(event), event["beams"], event["actors"]
            for sweep in simulated_sweeps(key[1], arrays, beams, actors, same, frame):
                put_sweep(scene, sweep)
        else:
            del waiting[key]
            if event["event"] == "error":
                asked.pop(key, None)  # the next change asks again
            bpy.context.window_manager.unisim_points = event.get("text", "")
    return POLL_S if waiting else None


@persistent
def follow(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Show the points of the frame that is shown now; while an image is rendered nothing changes."""
    about = scene.unisim
    if not (about.show_recorded or about.show_simulated) or bpy.app.is_job_running("RENDER"):
        return
    try:
        update(scene)
    except (UnisimError, OSError) as fault:
        bpy.context.window_manager.unisim_points = str(fault)


@persistent
def follow_edits(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Something changed: have a timer ask for the sweeps again, if they are others now."""
    if scene.unisim.show_simulated:
        run_soon(ask_again, EDIT_S)


def ask_again() -> None:
    """Ask for sweeps of the scene that is shown, as a timer of Blender's."""
    scene = bpy.context.scene
    if not scene.unisim.show_simulated or bpy.app.is_job_running("RENDER"):
        return
    try:
        ask_sweeps(scene)
    except (UnisimError, OSError) as fault:
        bpy.context.window_manager.unisim_points = str(fault)


def update(scene: bpy.types.Scene) -> None:
    """Show what the scene's switches ask for. Raises `UnisimError`."""
    for kind, wanted in ((RECORDED, scene.unisim.show_recorded), (SIMULATED, scene.unisim.show_simulated)):
        if not wanted:
            hide_points(scene, (kind, DROPS[kind]))
    if scene.unisim.show_recorded:
        show_recorded(scene)
    if scene.unisim.show_simulated:
        ask_sweeps(scene)
    else:
        asked.clear()


class UNISIM_OT_show_points(Editing, bpy.types.Operator):
    """Show recorded LiDAR points, simulated LiDAR points, or both, and on request beams that did not return"""

    bl_label = "Show LiDAR Points"
    needs = (drive,)

    recorded: bpy.props.BoolProperty(name="Recorded", description="Show recorded points", default=True)
    simulated: bpy.props.BoolProperty(name="Simulated", description="Show simulated points", default=False)
    drops: bpy.props.BoolProperty(
        name="Dropped Beams",
        description="Show beams that did not return, as points at 15 m: opaque where they returned in the other sweep",
        default=False,
    )

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        scene = context.scene
        about = scene.unisim
        about.show_recorded, about.show_simulated, about.show_drops = self.recorded, self.simulated, self.drops
        asked.clear()
        update(scene)
        redraw("VIEW_3D")
        return {"FINISHED"}


HANDLERS = (
    *(
        (name, follow) for name in ("frame_change_post", "undo_post", "redo_post")
    ),  # undo brings an older frame's points
    ("depsgraph_update_post", follow_edits),
)
TIMERS = (gather, ask_again, show_read)


def unregister() -> None:
    """Forget what was asked for."""
    waiting.clear()
    asked.clear()
    reading.clear()
