"""What several of Blender's tests do."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy

from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.core.scenario import apply_scenario
from unisim_blender.core.scenario.types import Scenario
from unisim_blender.core.world.drive import Drive
from unisim_blender.editing.sampled.source import scene_actors
from unisim_blender.features.drive.export_operators import scenario_of

SAMPLE = Path(__file__).parents[2] / "sample"
REAL_LOG = Path(os.environ.get("UNISIM_PANDASET", Path(__file__).parents[3] / "shared/data/pandaset/002"))


def read(scene: Any) -> Scenario:
    """The scenario that a scene stands for."""
    return scenario_of(scene, Path("/tmp/scenario.json"))


def edited(scene: Any) -> Drive:
    """The drive that a scene stands for."""
    return apply_scenario(read(scene), source_of(scene).drive, scene_actors)


def imported(scene: Any, kind: str, uid: str) -> Any:
    """The object of a kind and id that was imported."""
    return next(t for t in imported_objects(scene, kind) if t.unisim.uid == uid and t.name == t.unisim.home)


def select(*objects: Any) -> None:
    """Select objects and nothing else; the last is active."""
    for other in bpy.context.selected_objects:
        other.select_set(False)
    for one in objects:
        one.select_set(True)
        bpy.context.view_layer.objects.active = one


def driving(scene: Any, label: str = "") -> Any:
    """The first actor by id that drives, is there throughout, and has ``label`` in its class."""
    drive = source_of(scene).drive
    first, last = min(drive.time_s.values()), max(drive.time_s.values())
    uids = (
        u
        for u, a in sorted(drive.actors.items())
        if a.is_moving and a.start_s <= first and a.end_s >= last and label in a.label
    )
    return imported(scene, "ACTOR", next(uids))


def driving_car(scene: Any) -> Any:
    """A car that drives, present throughout, made the active one."""
    one = driving(scene, "Car")
    select(one)
    return one


def drawn(scene: Any, places: list[tuple[float, float, float]]) -> Any:
    """A curve of straight lines through places."""
    curve = bpy.data.curves.new("way", "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new("POLY")
    spline.points.add(len(places) - 1)
    for point, place in zip(spline.points, places, strict=True):
        point.co = (*place, 1)
    line = bpy.data.objects.new("way", curve)
    scene.collection.objects.link(line)
    return line


def calls(action: Callable[[], object]) -> int:
    """How many functions an action calls, Blender's and numpy's included: its work, whatever else the machine does."""
    count = 0

    def counted(frame: object, event: str, argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(counted)
    try:
        action()
    finally:
        sys.setprofile(None)
    return count
