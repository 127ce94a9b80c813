"""What several of Blender's tests do."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Generator
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import bpy
import numpy as np

from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.core.scenario import apply_scenario, load_scenario
from unisim_blender.core.scenario.types import Scenario
from unisim_blender.core.world.drive import Drive
from unisim_blender.editing.sampled.scene import same
from unisim_blender.editing.sampled.source import open_source, scene_actors
from unisim_blender.features.drive.export_operators import scenario_of

R = TypeVar("R")
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


def numbers(value: Any) -> Any:
    """A scenario's edits and sensors with numbers to 0.1 mm, so that one that was put back compares equal."""
    if isinstance(value, dict):
        return {name: numbers(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [numbers(part) for part in value]
    return round(value, 4) + 0.0 if isinstance(value, float) else value


def content(scenario: Scenario) -> Any:
    """What of a scenario the scene says."""
    sensors = scenario.sensors and asdict(scenario.sensors)
    return (
        numbers([[type(edit).__name__, asdict(edit)] for edit in scenario.edits]),
        numbers(sensors),
        numbers({uid: asdict(box) for uid, box in (scenario.boxes or {}).items()}),
    )


def material(name: str, colour: tuple[float, float, float]) -> Any:
    made = bpy.data.materials.new(name)
    if made.node_tree is None:
        made.use_nodes = True
    made.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (*colour, 1.0)
    return made


def crate(at: tuple[float, float, float], scale: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Any:
    """A cube of 2 m, times ``scale``, red but for its roof, which is green."""
    bpy.ops.mesh.primitive_cube_add(size=2.0, location=at, scale=scale)
    made = bpy.context.active_object
    made.data.materials.append(material("red", (0.6, 0.1, 0.1)))
    made.data.materials.append(material("green", (0.1, 0.6, 0.1)))
    for polygon in made.data.polygons:
        polygon.material_index = int(polygon.normal.z > 0.9)
    return made


def drive_of(path: Path) -> Drive:
    """The drive that a scenario leads to."""
    scenario = load_scenario(path)
    source = open_source(str(scenario.log_path), str(scenario.scene_path or ""))
    return apply_scenario(scenario, source.drive, scene_actors)


def assert_alike(a: Drive, b: Drive) -> None:
    """The same actors, sensors, boxes, and the same poses at every frame."""
    times = np.array([a.time_s[frame] for frame in a.frames])
    assert a.frames == b.frames
    assert set(a.actors) == set(b.actors)
    for uid, one in a.actors.items():
        other = b.actors[uid]
        assert one.appearance == other.appearance and one.label == other.label, uid
        there = one.present(times)
        assert (there == other.present(times)).all(), uid
        assert same(other.world_from_actor.at(times)[there], one.world_from_actor.at(times)[there]).all(), uid
    assert same(b.world_from_ego.at(times), a.world_from_ego.at(times)).all()
    assert set(a.cameras) == set(b.cameras) and set(a.lidars) == set(b.lidars)
    for name, camera in a.cameras.items():
        t = np.array(list(camera.time_s.values()))
        assert camera.model == b.cameras[name].model
        assert same(b.cameras[name].world_from_camera.at(t), camera.world_from_camera.at(t)).all(), name
    for name, lidar in a.lidars.items():
        t = np.array(list(lidar.time_s.values()))
        assert same(b.lidars[name].world_from_lidar.at(t), lidar.world_from_lidar.at(t)).all(), name
    assert len(a.static_copies) == len(b.static_copies) and len(a.static_removals) == len(b.static_removals)
    for mine, theirs in zip(a.static_copies, b.static_copies, strict=True):
        assert mine.uid == theirs.uid and same(theirs.world_from_target, mine.world_from_target)


def there_and_back(path: Path, folder: Path) -> Path:
    """Import a scenario into Blender and export it."""
    assert bpy.ops.unisim.import_scenario(filepath=str(path)) == {"FINISHED"}
    again = folder / "again.json"
    assert bpy.ops.unisim.export_scenario(filepath=str(again)) == {"FINISHED"}
    return again


def ended(steps: Generator[Any, None, R]) -> R:
    """What a generator returns after all its steps."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value
