"""Write a scenario's drive as OpenSCENARIO 1.3. Needs `scenariogeneration` (the extra ``openscenario``)."""

from __future__ import annotations

import datetime
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...files import write_file
from ...geometry import FloatArray, Trajectory
from ...world.classes import Motion, motion_of
from ...world.drive import EGO, Actor, Drive
from .paths import EgoVehicle, box_centre, ego_centre, place_of, shifted

MINOR = 3
EGO_HEIGHT_M = 1.5
"""Of the ego vehicle's box, which no log has."""
CATEGORIES = (
    ("semitrailer", ("semitrailer",)),
    ("trailer", ("trailer", "towed")),
    ("bus", ("bus",)),
    ("truck", ("truck", "construction")),
    ("tram", ("tram", "trolley")),
    ("train", ("train", "railed")),
    ("motorbike", ("motor", "scooter")),
    ("bicycle", ("bicycl", "cyclist", "rider", "pedicab", "wheeled")),
    ("van", ("van",)),
)
"""Vehicle categories by parts of a log's class names; "car" where none fits."""
WALKERS = ("pedestrian", "person", "human", "animal", "official", "wheelchair", "stroller", "dog")
EPOCH = datetime.datetime(2000, 1, 1)
"""The file's date: the same scenario gives the same bytes."""


def write(name: str, drive: Drive, vehicle: EgoVehicle, classes: Mapping[str, Motion] | None, folder: Path) -> str:
    """Write a drive as a scenario called ``name`` into a folder, and return the file's name. ``classes``: how actors of the log's
    classes move (`LogExtras.classes`); None where that is not known. Raises `OutputError`."""
    file = "".join(c if c.isalnum() or c in "-_." else "_" for c in name) + ".xosc"
    root = document(name, drive, vehicle, classes)
    ElementTree.indent(root)
    write_file(folder / file, ElementTree.tostring(root, "utf-8", xml_declaration=True) + b"\n")
    return file


def document(name: str, drive: Drive, vehicle: EgoVehicle, classes: Mapping[str, Motion] | None) -> Any:
    """Return the root element of a drive."""
    from scenariogeneration import xosc

    first, last = (drive.time_s[drive.frames[end]] for end in (0, -1))
    entities, init = xosc.Entities(), xosc.Init()
    act = xosc.Act("drive", _at(first))
    tracks: list[tuple[str, Trajectory, FloatArray, float, float, bool]] = []
    centre = ego_centre(vehicle, EGO_HEIGHT_M)
    box = xosc.BoundingBox(vehicle.width_m, vehicle.length_m, EGO_HEIGHT_M, *centre)
    entities.add_scenario_object(EGO, _vehicle(EGO, "car", box, vehicle.wheelbase_m))
    tracks.append((EGO, drive.world_from_ego, vehicle.ego_from_axle, first, last, True))
    for uid, actor in sorted(drive.actors.items()):
        if actor.is_ego_body:
            continue
        start, end = drive.window(actor)
        start, end = max(start, first), min(end, last)
        if start > end:
            continue
        kind, category = kind_of(actor, classes)
        length, width, height = actor.size_m.tolist()
        centre = box_centre(actor, kind == "vehicle")
        box = xosc.BoundingBox(width, length, height, *centre)
        entities.add_scenario_object(uid, _entity(uid, kind, category, box, length))
        offset = shifted((-centre[0], -centre[1], -centre[2]))
        tracks.append((uid, actor.world_from_actor, offset, start, end, actor.is_moving))
    for uid, track, offset, start, end, moves in tracks:
        events = []
        place = _position(track.at(start) @ offset)
        if start <= first:
            init.add_init_action(uid, xosc.TeleportAction(place))
        else:
            events.append(("appears", start, xosc.AddEntityAction(uid, place)))
        if moves and end > start:
            events.append(("drives", start, _follow(uid, track, offset, start, end)))
        if end < last:
            events.append(("vanishes", end, xosc.DeleteEntityAction(uid)))
        if events:
            act.add_maneuver_group(_group(uid, events))
    board = xosc.StoryBoard(init, _at(last, "end", "stop"))
    board.add_act(act)
    scenario = xosc.Scenario(
        name, "unisim", xosc.ParameterDeclarations(), entities, board, xosc.RoadNetwork(), xosc.Catalog(), MINOR,
        creation_date=EPOCH,
    )  # fmt: skip
    return scenario.get_element()


def kind_of(actor: Actor, classes: Mapping[str, Motion] | None) -> tuple[str, str]:
    """Return whether an actor is a "vehicle", a "pedestrian" or a "misc" object, and its category."""
    label = actor.label.lower()
    if any(word in label for word in WALKERS):
        words = ("wheelchair", "animal")
        return "pedestrian", next((word for word in words if word in label), "pedestrian")
    if motion_of(actor.label, classes) == "still":
        return "misc", "barrier" if "barrier" in label else "obstacle"
    return "vehicle", next((name for name, words in CATEGORIES if any(word in label for word in words)), "car")


def _entity(uid: str, kind: str, category: str, box: Any, length: float) -> Any:
    from scenariogeneration import xosc

    if kind == "pedestrian":
        return xosc.Pedestrian(uid, 80.0, getattr(xosc.PedestrianCategory, category), box)
    if kind == "misc":
        return xosc.MiscObject(uid, 10.0, getattr(xosc.MiscObjectCategory, category), box)
    return _vehicle(uid, category, box, 0.6 * length)


def _vehicle(uid: str, category: str, box: Any, wheelbase: float) -> Any:
    from scenariogeneration import xosc

    front = xosc.Axle(0.5, 0.7, 1.6, wheelbase, 0.35)
    rear = xosc.Axle(0.0, 0.7, 1.6, 0.0, 0.35)
    kind = getattr(xosc.VehicleCategory, category)
    return xosc.Vehicle(uid, kind, box, front, rear, 70.0, 10.0, 10.0)


def _position(pose: FloatArray) -> Any:
    from scenariogeneration import xosc

    return xosc.WorldPosition(*place_of(pose))


def _follow(uid: str, track: Trajectory, offset: FloatArray, start: float, end: float) -> Any:
    from scenariogeneration import xosc

    inside = track.times_s[(track.times_s > start) & (track.times_s < end)]
    times = np.concatenate([[start], inside, [end]])
    path = xosc.Trajectory(f"{uid} path", False)
    path.add_shape(xosc.Polyline(times.tolist(), [_position(pose) for pose in track.at(times) @ offset]))
    mode, domain = xosc.FollowingMode.position, xosc.ReferenceContext.absolute
    return xosc.FollowTrajectoryAction(path, mode, domain, 1.0, 0.0)


def _group(uid: str, events: list[tuple[str, float, Any]]) -> Any:
    from scenariogeneration import xosc

    maneuver = xosc.Maneuver(f"{uid} maneuver")
    for what, time_s, action in events:
        event = xosc.Event(f"{uid} {what}", xosc.Priority.parallel)
        event.add_trigger(_at(time_s))
        event.add_action(f"{uid} {what}", action)
        maneuver.add_event(event)
    group = xosc.ManeuverGroup(f"{uid} group")
    group.add_actor(uid)
    group.add_maneuver(maneuver)
    return group


def _at(time_s: float, name: str = "time", point: str = "start") -> Any:
    from scenariogeneration import xosc

    condition = xosc.SimulationTimeCondition(time_s, xosc.Rule.greaterOrEqual)
    return xosc.ValueTrigger(name, 0.0, xosc.ConditionEdge.none, condition, point)
