"""From a seed to everything that stands in the street: houses, furniture, vehicles, cones. x runs along the street, z
up; the road's middle line is y = 0, traffic keeps to the right, and the ego sets out along +x at x = 0. Of a street with
bends these are its own coordinates, which its `Course` puts into the street's frame; until the first bend they are the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_yaw
from unisim_blender.core.world.drive import Actor, Appearance

from .assets import furniture
from .assets.buildings import front_pose, house
from .assets.cars import PAINTS, STYLES, car
from .assets.lamps import TRAFFIC_LIGHT_SIZE_M, traffic_light, with_rear_lamps
from .assets.people import CYCLIST_SIZE_M, PERSON_SIZE_M, cyclist, person
from .assets.road import (
    HALF_ROAD_WIDTH_M,
    HALF_STREET_WIDTH_M,
    KERB_HEIGHT_M,
    LANE_WIDTH_M,
    STRAIGHT_COURSE,
    Course,
    RoadPlan,
)
from .paint.materials import Plain
from .tracing.trace import Asset, AssetPart

SPEED_M_S = 8.0
FRAME_S = 0.1
EGO_Y_M = -LANE_WIDTH_M / 2
PARKED_Y_M = 4.62
_TRAFFIC_END_M = 10.0
"""Where traffic leaves a street, before the houses that close it."""
_PARKED_STYLES = ("sedan", "hatchback", "suv", "estate", "van", "hatchback", "suv", "sedan")


StreetKind = Literal["straight", "night", "curve", "crossing"]
CURVE_RADIUS_M, CURVE_RAD = 60.0, np.pi / 2
"""Radius of a curve at the middle line, and how far it turns: from 4 m ahead of the drive's start, odd seeds to the right."""
_TURN_RADIUS_M, _TURN_SPEED_M_S = 5.5, 5.5
"""Of cars that turn at a crossing."""
_SIDE_STREET_M = 45.0
"""How far beside the street cars of the side street are there: houses close it."""


@dataclass(frozen=True)
class Layout:
    """Contents of the street that a seed generates. Assets by actor uid; actors and lamps (L, 3) in the street's frame. The
    last ``thin`` parts of ``static`` are wires, masts, railings and fences."""

    plan: RoadPlan
    static: Asset
    thin: int
    assets: dict[str, Asset]
    actors: dict[str, Actor]
    lamps: FloatArray


def ego_poses(time_s: FloatArray, speed_m_s: float = SPEED_M_S, course: Course = STRAIGHT_COURSE) -> FloatArray:
    """Ego poses (T, 4, 4) at times (T,): a steady drive with the small weaving of a driver who keeps a lane."""
    t = np.asarray(time_s, np.float64)
    omega = 2 * np.pi / 5.2
    x = speed_m_s * t
    y = EGO_Y_M + 0.16 * np.sin(omega * t)
    yaw = np.arctan2(0.16 * omega * np.cos(omega * t), speed_m_s)
    x, y, yaw = course.place(x, y, yaw)
    return make_pose(np.stack([x, y, np.zeros_like(x)], -1), quaternion_from_yaw(yaw))


def lay_out(
    seed: int,
    frames: int,
    speed_m_s: float = SPEED_M_S,
    turns_deg: Sequence[float] = (),
    traffic_leaves: bool = False,
    kind: StreetKind = "straight",
    people: int = 0,
    thin: bool = False,
    lamps: bool = False,
) -> Layout:
    """The layout of a seed, long enough for a drive of that many frames.

    A drive along a curve lies in it; one over a crossing reaches it about the drive's end, and meets cars that turn.

    ``traffic_leaves``: the street ends soon beyond the drive, and oncoming cars are there while they are in it; else it is so
    long that none reaches an end. Raises `LogError` where the drive is too short for the turns.
    """
    rng = np.random.default_rng([seed, 20230618])
    travel = speed_m_s * FRAME_S * (frames - 1)
    course = Course(turns_deg, travel)
    crossing_x = travel + float(rng.uniform(38.0, 44.0))
    if kind == "curve":
        arc = CURVE_RADIUS_M * CURVE_RAD
        course = Course.of_legs((4.0, 0.0), (arc, (-1.0) ** seed / CURVE_RADIUS_M), (0.0, 0.0))
        crossing_x = max(crossing_x, arc + 20.0)
    elif kind == "crossing":
        crossing_x += 0.6 * travel - travel - 26.0
    start_x, end_x = -100.0 - 1.3 * travel, travel + 1.3 * travel + 125.0
    if traffic_leaves:
        start_x, end_x = -140.0, travel + 170.0
    crossing = (crossing_x, crossing_x + 9.0)
    plan = RoadPlan(start_x, end_x, crossing, _patches(rng, travel), _manholes(rng, travel), course)
    work_x = travel * 0.5 + float(rng.uniform(13.0, 16.0))
    if kind == "crossing":
        work_x = crossing[1] + 20.0
    parts = _houses(rng, plan) + _furniture(rng, plan, travel, work_x)
    assets: dict[str, Asset] = {}
    actors: dict[str, Actor] = {}
    times = FRAME_S * np.arange(frames)
    leaves = (start_x + _TRAFFIC_END_M, end_x - _TRAFFIC_END_M) if traffic_leaves else None
    _add_cars(rng, plan, travel, work_x, times, speed_m_s, leaves, kind == "crossing", assets, actors)
    _add_cones(rng, course, work_x, times, assets, actors)
    _add_people(np.random.default_rng([seed, 20241103]), course, people, travel, times, assets, actors)
    if lamps:
        parts += _add_lamps(course, travel, times, assets, actors)
    hung = [course.pose(x) @ [*furniture.lamp_tip(_kerb(x, side), -side), 1.0] for x, side in _lamp_posts(plan, travel)]
    thin_parts = _thin_things(plan, travel) if thin else []
    static = Asset("static", (*parts, *thin_parts))
    return Layout(plan, static, len(thin_parts), assets, actors, np.stack(hung)[:, :3])


def _kerb(x: float, side: float) -> FloatArray:
    """Where what stands along the kerb of a side stands."""
    return np.array([x, side * (HALF_ROAD_WIDTH_M + 0.55), KERB_HEIGHT_M])


def _lamp_posts(plan: RoadPlan, travel: float) -> list[tuple[float, float]]:
    """Places along the street, and sides, of lamp posts: none at the crossing."""
    return [
        (float(x), side)
        for side, shift in ((1.0, 0.0), (-1.0, 11.0))
        for x in np.arange(-62.0 + shift, travel + 95.0, 22.0)
        if not plan.crossing[0] - 5.5 < x < plan.crossing[1] + 5.5
    ]


def _patches(rng: np.random.Generator, travel: float) -> tuple[tuple[float, float, float, float], ...]:
    count = 6 + int(travel / 12)
    x = rng.uniform(-30, travel + 60, count)
    y = rng.uniform(-4.5, 4.5, count)
    return tuple(
        (float(a), float(b), float(c), float(d))
        for a, b, c, d in zip(x, y, rng.uniform(0.6, 3.5, count), rng.uniform(0.3, 0.9, count), strict=True)
    )


def _manholes(rng: np.random.Generator, travel: float) -> tuple[tuple[float, float], ...]:
    x = np.arange(-30.0, travel + 70.0, 13.0)
    y = rng.choice([-1.9, 1.7, -0.6, 2.3], len(x))
    return tuple((float(a), float(b)) for a, b in zip(x + rng.uniform(-3, 3, len(x)), y, strict=True))


def _houses(rng: np.random.Generator, plan: RoadPlan) -> list[AssetPart]:
    parts: list[AssetPart] = []
    number = 0
    for side in (1.0, -1.0):
        for low, high in ((plan.start_x, plan.crossing[0] - 3.4), (plan.crossing[1] + 3.4, plan.end_x)):
            x = low
            while x < high - 6.0:
                width = float(rng.uniform(8.5, 15.0))
                width = high - x if high - x - width < 7.0 else width
                setback = float(rng.choice([0.0, 0.0, 0.35, 0.8]))
                y = side * (HALF_STREET_WIDTH_M + setback)
                pose = (
                    front_pose(x, y, KERB_HEIGHT_M, 0.0) if side > 0 else front_pose(x + width, y, KERB_HEIGHT_M, np.pi)
                )
                parts += plan.course.stood(house(rng, pose, width, number), x + width / 2)
                number += 1
                x += width + (0.0 if rng.random() < 0.8 else float(rng.uniform(1.5, 3.0)))
    # houses that close the street at both ends, and the side street
    middle = (plan.crossing[0] + plan.crossing[1]) / 2
    for x, yaw in ((plan.end_x + 9.0, -np.pi / 2), (plan.start_x - 9.0, np.pi / 2)):
        for i in range(-2, 3):
            corner = (x, -14.0 * i + 7.0) if yaw < 0 else (x, -14.0 * i - 7.0)
            parts += plan.course.stood(
                house(rng, front_pose(corner[0], corner[1], 0.0, yaw), 14.0, number, plain=True), x
            )
            number += 1
    for i in range(-2, 3):
        for yaw, y in ((0.0, 58.0), (np.pi, -58.0)):
            x = middle + 13.0 * i + (-6.5 if yaw == 0.0 else 6.5)
            parts += plan.course.stood(house(rng, front_pose(x, y, 0.0, yaw), 13.0, number, plain=True), middle)
            number += 1
    return parts


def _furniture(rng: np.random.Generator, plan: RoadPlan, travel: float, work_x: float) -> list[AssetPart]:
    parts: list[AssetPart] = []
    stood = plan.course.stood
    kerb_y = HALF_ROAD_WIDTH_M + 0.55

    def clear(x: float, room: float = 5.5) -> bool:
        return not plan.crossing[0] - room < x < plan.crossing[1] + room

    for side, shift in ((1.0, 0.0), (-1.0, 11.0)):
        for x, beside in _lamp_posts(plan, travel):
            if beside == side:
                parts += stood(furniture.lamp_post(_kerb(x, side), -side), x)
        for x in np.arange(-56.0 + shift, travel + 95.0, 11.0):
            x = float(x + rng.uniform(-1.2, 1.2))
            if clear(x, 7.0) and rng.random() < 0.5:
                parts += stood(furniture.tree(np.array([x, side * (kerb_y + 0.35), KERB_HEIGHT_M]), rng), x)
        for x in np.arange(-40.0, travel + 60.0, 4.0):
            x = float(x + rng.uniform(-1.0, 1.0))
            if not clear(x, 4.0):
                continue
            kind = rng.random()
            near, far = (
                np.array([x, side * kerb_y, KERB_HEIGHT_M]),
                np.array([x, side * (HALF_STREET_WIDTH_M - 0.75), KERB_HEIGHT_M]),
            )
            if kind < 0.14:
                parts += stood(furniture.litter_bin(near), x)
            elif kind < 0.22:
                parts += stood(furniture.hydrant(near), x)
            elif kind < 0.34:
                parts += stood(furniture.planter(far), x)
            elif kind < 0.42:
                parts += stood(furniture.bench(far, 0.0 if side > 0 else np.pi), x)
            elif kind < 0.62:
                parts += stood(furniture.bollard(near), x)
            elif kind < 0.72:
                parts += stood(furniture.sign(near, np.pi if side < 0 else 0.0, int(rng.integers(3))), x)
    for x in (plan.crossing[0] - 0.6, plan.crossing[1] + 0.6):
        for side in (1.0, -1.0):
            at = np.array([x, side * (kerb_y + 0.1), KERB_HEIGHT_M])
            parts += stood(furniture.sign(at, np.pi if x < plan.crossing[0] else 0.0, 0 if side > 0 else 2), x)
    parts += stood(furniture.hydrant(np.array([travel * 0.5 + 9.0, -kerb_y, KERB_HEIGHT_M])), travel * 0.5 + 9.0)
    skip = furniture.skip_container(np.array([work_x + 5.6, -PARKED_Y_M, 0.0]), "#b98a1e")
    parts += stood(skip, work_x + 5.6)
    return parts


def _thin_things(plan: RoadPlan, travel: float) -> list[AssetPart]:
    """Masts with wires along and across the street, railings at the kerb, fences before houses."""
    parts: list[AssetPart] = []
    side_y, length = HALF_STREET_WIDTH_M - 0.5, 24.0
    kerb_y = HALF_ROAD_WIDTH_M + 0.3

    def clear(x: float, room: float) -> bool:
        return not plan.crossing[0] - room < x < plan.crossing[1] + 4.0

    for number, x in enumerate(np.arange(-36.0, travel + 60.0, length)):
        group: list[AssetPart] = []
        if clear(float(x), 4.0):
            group += furniture.mast(np.array([x, side_y, KERB_HEIGHT_M]))
            group += furniture.mast(np.array([x, -side_y, KERB_HEIGHT_M]))
            group += furniture.wire(np.array([x, -side_y, 7.2]), np.array([x, side_y, 7.2]), 0.3)
        for y, z in ((side_y, 7.4), (side_y, 6.8), (-side_y, 7.4)):
            group += furniture.wire(np.array([x, y, z]), np.array([x + length, y, z]))
        side = 1.0 if number % 2 else -1.0
        if clear(float(x) + 6.0, 14.0):
            at = np.array([x + 5.0, side * kerb_y, KERB_HEIGHT_M])
            group += furniture.bars(at, 9.0, 1.05, 1.5, 0.022, (0.5, 1.03), "#8d9293")
            at = np.array([x + 4.0, -side * (side_y - 0.4), KERB_HEIGHT_M])
            group += furniture.bars(at, 8.0, 1.15, 0.16, 0.009, (0.15, 1.05), "#202822")
        parts += plan.course.stood(group, float(x))
    return parts


def _actor(uid: str, label: str, size: FloatArray, keys: Trajectory, moving: bool, times: FloatArray) -> Actor:
    # an actor is there all through the drive, the last sweep's and the first image's margins included
    return Actor(uid, label, size, keys, float(times[0]) - 0.5, float(times[-1]) + 0.5, moving, Appearance(uid))


def _add_cars(
    rng: np.random.Generator,
    plan: RoadPlan,
    travel: float,
    work_x: float,
    times: FloatArray,
    speed_m_s: float,
    leaves: tuple[float, float] | None,
    turns: bool,
    assets: dict[str, Asset],
    actors: dict[str, Actor],
) -> None:
    paints = list(rng.permutation(PAINTS))

    def add(kind: str, keys: FloatArray, yaw: FloatArray, moving: bool, way: Course = plan.course) -> None:
        uid = f"car-{len([a for a in actors if a.startswith('car-')]) + 1:02d}"
        style = STYLES[kind]
        assets[uid] = car(uid, style, str(paints[len(actors) % len(paints)]))
        there = times
        if moving and leaves is not None:
            inside = np.flatnonzero((keys[:, 0] > leaves[0]) & (keys[:, 0] < leaves[1]))
            there = times[inside]
        keys[:, 2] = style.height / 2
        keys[:, 0], keys[:, 1], yaw = way.place(keys[:, 0], keys[:, 1], yaw)
        if way is not plan.course:
            there = times[np.abs(keys[:, 1]) < _SIDE_STREET_M]
        trajectory = Trajectory(times if moving else times[:1], keys, quaternion_from_yaw(yaw))
        actors[uid] = _actor(uid, style.label, style.size_m, trajectory, moving, there)

    # kind, x, y, speed, heading, and metres that it gains on that speed in its first seconds
    moving = [
        ("sedan", 16.0, -LANE_WIDTH_M / 2 + 0.05, speed_m_s, 0.0, 8.0),
        ("truck", 50.0, -LANE_WIDTH_M / 2, speed_m_s, 0.0, -4.0),
        ("suv", 34.0, LANE_WIDTH_M / 2, 8.4, np.pi, 0.0),
        ("hatchback", 58.0, LANE_WIDTH_M / 2 + 0.1, 8.4, np.pi, 3.0),
        ("pickup", -13.0, -LANE_WIDTH_M / 2 - 0.05, speed_m_s, 0.0, 1.5),
    ]
    oncoming = 2 * travel if leaves is None else travel + 8.4 * float(times[-1])
    if turns:
        for kind, way, begin, speed in _turning_cars(plan.crossing, float(times[-1]), speed_m_s):
            along = np.stack([begin + speed * times, 0 * times, 0 * times], -1)
            add(kind, along, 0 * times, True, way)
        behind = plan.crossing[1] + 8.4 * (0.8 * float(times[-1]) + 3.5)
        moving = [("suv", 12.0, *moving[2][2:]), ("hatchback", behind, *moving[3][2:]), moving[4]]
        oncoming = 0.0
    for x in np.arange(95.0, 60.0 + oncoming, 37.0):
        moving.append(
            (_PARKED_STYLES[int(rng.integers(len(_PARKED_STYLES)))], float(x), LANE_WIDTH_M / 2, 8.4, np.pi, 0.0)
        )
    for kind, x, y, speed, yaw, gain in moving:
        run = speed * times + gain * (1 - np.exp(-times / 3.0))
        path = np.stack(
            [x + run * np.cos(yaw), np.full_like(run, y) + 0.06 * np.sin(run / 9.0), np.zeros_like(run)], -1
        )
        lean = np.arctan2(0.06 / 9.0 * np.cos(run / 9.0), 1.0) * np.cos(yaw)
        add(kind, path, yaw + lean, True)
    for side in (-1.0, 1.0):
        x = -16.0 + float(rng.uniform(0, 3)) + (4.0 if side > 0 else 0.0)
        while x < (plan.crossing[1] + 45.0 if turns else travel + 34.0):
            blocked = side < 0 and work_x - 9.5 < x < work_x + 11.0
            near_crossing = plan.crossing[0] - 9.0 < x < plan.crossing[1] + 9.0
            if not blocked and not near_crossing and rng.random() < 0.62:
                kind = _PARKED_STYLES[int(rng.integers(len(_PARKED_STYLES)))]
                turn = (0.0 if side < 0 else np.pi) + float(rng.normal(0, 0.012))
                add(kind, np.array([[x, side * PARKED_Y_M + rng.normal(0, 0.06), 0.0]]), np.array([turn]), False)
            x += float(rng.uniform(6.0, 7.6))


def _add_people(
    rng: np.random.Generator,
    course: Course,
    count: int,
    travel: float,
    times: FloatArray,
    assets: dict[str, Asset],
    actors: dict[str, Actor],
) -> None:
    """Walkers on both pavements beside the kerb, some towards the ego; the second is a cyclist at the lane's edge."""
    for number in range(1, count + 1):
        if number == 2:
            uid, label, size, asset = "cyclist-1", "Bicycle", CYCLIST_SIZE_M, cyclist("cyclist-1", rng)
            x, y, speed, way, ground = 0.25 * travel + float(rng.uniform(8, 11)), -3.05, 4.4, 1.0, 0.0
        else:
            uid = f"person-{number - (number > 2):02d}"
            label, size, asset = "Pedestrian", PERSON_SIZE_M, person(uid, rng)
            x = 9.0 + (0.6 * travel + 14.0) * float(rng.uniform((number - 1) / count, number / count))
            side, way = float(rng.choice([-1.0, 1.0])), float(rng.choice([-1.0, 1.0]))
            y, speed, ground = side * (HALF_STREET_WIDTH_M - 1.85), float(rng.uniform(1.1, 1.6)), KERB_HEIGHT_M
        assets[uid] = asset
        path = x + way * speed * times
        keys = np.stack([path, y + 0.05 * np.sin(path), np.full_like(path, ground + size[2] / 2)], -1)
        yaw = np.arctan2(way * 0.05 * np.cos(path), way)
        keys[:, 0], keys[:, 1], yaw = course.place(keys[:, 0], keys[:, 1], yaw)
        actors[uid] = _actor(uid, label, size.copy(), Trajectory(times, keys, quaternion_from_yaw(yaw)), True, times)


def _add_lamps(
    course: Course, travel: float, times: FloatArray, assets: dict[str, Asset], actors: dict[str, Actor]
) -> list[AssetPart]:
    """A traffic light that turns from red to green, at the kerb ahead, and its post; the first car brakes, and indicates
    left."""
    end, x, y, z = float(times[-1]), 0.8 * travel + 14.0, -HALF_ROAD_WIDTH_M - 0.3, 2.6
    at, foot = np.array([[x, y, z]]), np.array([x + 0.22, y, KERB_HEIGHT_M])
    at[:, 0], at[:, 1], yaw = course.place(at[:, 0], at[:, 1], np.array([np.pi]))
    assets["traffic-light"] = traffic_light("traffic-light", 0.45 * end)
    keys = Trajectory(times[:1], at, quaternion_from_yaw(yaw))
    actors["traffic-light"] = _actor("traffic-light", "Signs", TRAFFIC_LIGHT_SIZE_M.copy(), keys, False, times)
    assets["car-01"] = with_rear_lamps(assets["car-01"], STYLES["sedan"], (0.3 * end, 0.7 * end), end)
    return course.stood([furniture.strut(Plain("#3c4240"), foot, foot + [0.0, 0.0, z + 0.3], 0.05, 0.05)], x)


def _turning_cars(
    crossing: tuple[float, float], duration_s: float, speed_m_s: float
) -> list[tuple[str, Course, float, float]]:
    """Cars that turn at a crossing: their style, way, metres along it at the drive's start, and speed.

    The car ahead of the ego turns right, in time for it to go on; one from the right turns left before it; one that comes
    towards it turns right; one from the left waits.
    """
    middle, lane, speed = sum(crossing) / 2, LANE_WIDTH_M / 2, _TURN_SPEED_M_S
    side, radius, far = 2.2, _TURN_RADIUS_M, 100.0
    right = (radius * np.pi / 2, -1 / radius), (0.0, 0.0)
    run = middle - side - radius
    wide = radius + 1.0
    near = far + lane - wide
    left = (near, 0.0), (wide * np.pi / 2, 1 / wide), (0.0, 0.0)
    ahead = Course.of_legs((run, 0.0), *right, start=(0.0, -lane))
    crosses = Course.of_legs(*left, start=(middle + side, -far), heading=np.pi / 2)
    oncoming = Course.of_legs((far, 0.0), *right, start=(middle + side + radius + far, lane), heading=np.pi)
    waits = Course.of_legs((far, 0.0), (0.0, 0.0), start=(middle - side, far), heading=-np.pi / 2)
    return [
        ("sedan", ahead, min(run - speed * (run / speed_m_s - 2.8), run + 2.0), speed),
        ("hatchback", crosses, near - speed * 0.3 * duration_s, speed),
        ("estate", oncoming, far - speed * 0.75 * duration_s, speed),
        ("van", waits, far - 12.0, 0.3),
    ]


def _add_cones(
    rng: np.random.Generator,
    course: Course,
    work_x: float,
    times: FloatArray,
    assets: dict[str, Asset],
    actors: dict[str, Actor],
) -> None:
    spots = ((-6.0, -5.2), (-4.6, -4.5), (-2.6, -3.75), (0.2, -3.7), (2.8, -3.72))
    for i, (dx, y) in enumerate(spots, 1):
        uid = f"cone-{i}"
        assets[uid] = furniture.cone_asset(uid)
        at = np.array([[work_x + dx + rng.normal(0, 0.1), y + rng.normal(0, 0.05), furniture.CONE_SIZE_M[2] / 2]])
        at[:, 0], at[:, 1], yaw = course.place(at[:, 0], at[:, 1], rng.uniform(-3, 3, 1))
        trajectory = Trajectory(times[:1], at, quaternion_from_yaw(yaw))
        actors[uid] = _actor(uid, "Cones", furniture.CONE_SIZE_M.copy(), trajectory, False, times)
