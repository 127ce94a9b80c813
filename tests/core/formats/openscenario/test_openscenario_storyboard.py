"""What entities of OpenSCENARIO do: motions worked by hand, on a straight drive of four seconds."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.formats.openscenario.expressions import ExpressionError, Scope
from unisim_blender.core.formats.openscenario.read import edits_of
from unisim_blender.core.geometry import Trajectory, quaternion_from_yaw
from unisim_blender.core.scenario import plain
from unisim_blender.core.scenario.edits.duplicate import Duplicate
from unisim_blender.core.scenario.edits.ego import Ego
from unisim_blender.core.scenario.edits.move import Move
from unisim_blender.core.scenario.edits.remove import Remove
from unisim_blender.core.simulation.vehicle.parameters import Vehicle
from unisim_blender.core.world.drive import Actor, Appearance, Drive

END_S = 4.0
Where = Callable[[float], tuple[float, float, float]]


def straight(x: float, y: float, speed: float, z: float = 0.0) -> Trajectory:
    times = np.array([0.0, END_S])
    positions = np.stack([x + speed * times, np.full(2, y), np.full(2, z)], 1)
    return Trajectory(times, positions, quaternion_from_yaw(np.zeros(2)))


def drive() -> Drive:
    """The ego at 10 m/s along x from 0; "lead" 40 m ahead at 5 m/s; "other" beside it at 8 m/s."""
    tracks = {"lead": straight(40, 0, 5), "other": straight(0, 3.5, 8)}
    actors = {
        uid: Actor(uid, "Car", np.array([4.0, 2.0, 1.5]), track, -0.1, END_S + 0.1, True, Appearance(uid))
        for uid, track in tracks.items()
    }
    frames = tuple(range(41))
    return Drive("straight", frames, {one: one / 10 for one in frames}, straight(0, 0, 10), {}, {}, actors)


def entity(name: str) -> str:
    return f"""<ScenarioObject name="{name}"><Vehicle name="{name}" vehicleCategory="car"><BoundingBox><Center x="0" y="0"
z="0"/><Dimensions width="2" length="4" height="1.5"/></BoundingBox></Vehicle></ScenarioObject>"""


def private(action: str) -> str:
    return f"<PrivateAction>{action}</PrivateAction>"


def teleport(position: str) -> str:
    return private(f"<TeleportAction><Position>{position}</Position></TeleportAction>")


def world(x: float, y: float = 0.0, h: str = 'h="0"') -> str:
    return f'<WorldPosition x="{x}" y="{y}" z="0" {h}/>'


def lane(s: float, number: int = -1, road: int = 0, inside: str = "") -> str:
    return f'<LanePosition roadId="{road}" laneId="{number}" s="{s}">{inside}</LanePosition>'


def speed(target: str, dynamics: str = 'dynamicsShape="step"') -> str:
    target = target if target.startswith("<") else f'<AbsoluteTargetSpeed value="{target}"/>'
    return private(f"""<LongitudinalAction><SpeedAction><SpeedActionDynamics {dynamics}/><SpeedActionTarget>{target}
</SpeedActionTarget></SpeedAction></LongitudinalAction>""")


def follow(line: str, mode: str = "follow", timing: str = "", more: str = "", closed: str = "false") -> str:
    timing = timing or "<None/>"
    return private(f"""<RoutingAction><FollowTrajectoryAction {more}><TrajectoryRef><Trajectory name="t" closed="{closed}">
<Shape>{line}</Shape></Trajectory></TrajectoryRef><TimeReference>{timing}</TimeReference><TrajectoryFollowingMode
followingMode="{mode}"/></FollowTrajectoryAction></RoutingAction>""")


def polyline(*vertices: tuple[float | None, str]) -> str:
    every = []
    for time, place in vertices:
        when = "" if time is None else f' time="{time}"'
        every.append(f"<Vertex{when}><Position>{place}</Position></Vertex>")
    return f"<Polyline>{''.join(every)}</Polyline>"


def timing(domain: str = "relative", offset: float = 0.0, scale: float = 1.0) -> str:
    return f'<Timing domainAbsoluteRelative="{domain}" offset="{offset}" scale="{scale}"/>'


def after(time_s: float, delay: float = 0.0) -> str:
    return condition(
        f'<ByValueCondition><SimulationTimeCondition value="{time_s}" rule="greaterThan"/></ByValueCondition>', delay
    )


def condition(content: str, delay: float = 0.0, edge: str = "none") -> str:
    return f"""<StartTrigger><ConditionGroup><Condition name="c" delay="{delay}" conditionEdge="{edge}">{content}</Condition>
</ConditionGroup></StartTrigger>"""


def of_entity(name: str, content: str, edge: str = "none") -> str:
    return condition(
        f"""<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any"><EntityRef entityRef="{name}"/>
</TriggeringEntities><EntityCondition>{content}</EntityCondition></ByEntityCondition>""",
        edge=edge,
    )


def event(name: str, actions: str, trigger: str = "", priority: str = "parallel") -> str:
    return (
        f'<Event name="{name}" priority="{priority}"><Action name="{name} action">{actions}</Action>{trigger}</Event>'
    )


def group(actor: str, events: str) -> str:
    return f"""<ManeuverGroup name="g" maximumExecutionCount="1"><Actors selectTriggeringEntities="false"><EntityRef
entityRef="{actor}"/></Actors><Maneuver name="{actor} maneuver">{events}</Maneuver></ManeuverGroup>"""


def written(entities: str, init: str, groups: str = "", parameters: str = "", head: str = "", act: str = "") -> str:
    return f"""<OpenSCENARIO><FileHeader revMajor="1" revMinor="3"/><ParameterDeclarations>{parameters}
</ParameterDeclarations>{head}<Entities>{entities}</Entities><Storyboard><Init><Actions>{init}</Actions></Init>
<Story name="s"><Act name="a">{groups}{act}</Act></Story></Storyboard></OpenSCENARIO>"""


def start(name: str, *actions: str) -> str:
    return f'<Private entityRef="{name}">{"".join(actions)}</Private>'


def read(text: str, path: Path = Path("by_hand.xosc"), **actors: str) -> tuple[dict[str, list[object]], list[str]]:
    """The edits by actor, "ego" for the recording vehicle, and the sentences without those of boxes and categories."""
    vehicle = Vehicle()
    found = edits_of(ElementTree.fromstring(text), drive(), vehicle, path, actors)
    edits: dict[str, list[object]] = {}
    for edit in found.edits:
        edits.setdefault(str(plain(edit).get("actor", "ego")), []).append(edit)
    boxes = "Vehicle: not read: vehicleCategory", "entity 'Ego': its box", "entity 'hero': its box"
    return edits, [one for one in found.losses if not one.startswith(boxes)]


def at(edit: object) -> Where:
    """Give x, y and heading in degrees of an edit at a time."""
    assert isinstance(edit, Move | Ego | Duplicate)
    keys = edit.trajectory
    if keys is None:
        assert not isinstance(edit, Ego) and edit.pose is not None and edit.pose.quaternion_wxyz is not None
        (x, y, _), (w, _, _, z) = edit.pose.position, edit.pose.quaternion_wxyz
        return lambda time_s: (x, y, math.degrees(2 * math.atan2(z, w)))
    times = np.array([key.time_s for key in keys], float)
    assert (np.diff(times) > 0).all() and 0 <= times[0] and times[-1] <= END_S
    track = Trajectory(times, np.array([key.position for key in keys]), np.array([key.quaternion_wxyz for key in keys]))

    def where(time_s: float) -> tuple[float, float, float]:
        pose = track.at(min(time_s, float(times[-1])))
        return float(pose[0, 3]), float(pose[1, 3]), math.degrees(math.atan2(pose[1, 0], pose[0, 0]))

    return where


def lead(init: str, events: str = "", **more: str) -> tuple[Where, list[str]]:
    """What "lead" does after its own init and its events."""
    edits, said = read(written(entity("lead"), start("lead", init), group("lead", events) if events else "", **more))
    return at(edits["lead"][0]), said


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("${1 + 2 * 3 - -4}", 11.0),
        ("${(1 + 2) * 3 % 5}", 4.0),
        ("${-7 % 4}", -3.0),
        ("${2 * -$a}", -6.0),
        ("${round(2.5) + floor(-1.5) + ceil(1.2)}", 3.0),
        ("${sqrt(pow($a, 2) + 16)}", 5.0),
        ("${min(4, $a, 9) + max(1, 2)}", 5.0),
        ("${sin(pi / 6) + cos(0) + tan(0) + acos(1) + abs(-2) + sign(-3)}", 2.5),
        ("${1 < 2 and not ($a == 4 or false)}", True),
        ("${$a >= 3}", True),
        ("${'x' == $text}", True),
        ("$text", "x"),
        ("plain", "plain"),
        ("${1e-3 * .5}", 5e-4),
    ],
)
def test_expressions(text: str, value: object) -> None:
    found = Scope({"a": "${$b - 1}", "b": "4", "text": "x"}).value(text)
    assert found == (pytest.approx(value) if isinstance(value, float) else value)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("${1 / 0}", "divides by 0"),
        ("${1 +}", "ends too early"),
        ("${(1}", "bracket is not closed"),
        ("${1 2}", "is not expected"),
        ("${__import__('os')}", "is not known"),
        ("${$a.b}", "there is no parameter"),
        ("${sqrt(-1)}", "has no value"),
        ("${'a' + 1}", "is no number"),
        ("$loop", "made of itself"),
        ("${" + "(" * 200 + "1" + ")" * 200 + "}", "brackets"),
        ("${pow(10, 300) * pow(10, 300)}", "no finite value"),
    ],
)
def test_expressions_without_a_value(text: str, why: str) -> None:
    with pytest.raises(ExpressionError, match=why):
        Scope({"a": "1", "loop": "${$loop2 + 1}", "loop2": "$loop"}).value(text)


def test_a_parameter_hides_that_of_the_scope_around() -> None:
    outer = Scope({"v": "2", "w": "${$v * 10}"})
    assert Scope({"v": "${$v + 1}"}, outer).value("${$v + $w}") == 23.0


CORNER = polyline((0.0, world(0, 0, "")), (1.0, world(0, 8, "")), (2.0, world(-8, 8, "")))


def test_headings_follow_the_path_or_are_as_they_are_written() -> None:
    where, said = lead("", event("e", follow(CORNER, "follow", timing())))
    assert [round(where(one)[2]) for one in (0.0, 0.5, 1.0, 1.5)] == [90, 90, 135, 180] and said == []
    where, said = lead("", event("e", follow(CORNER, "position", timing())))
    assert where(0.5)[2] == 0.0
    assert said == ['s/a/e/e action: a WorldPosition without h has the heading 0 where followingMode is "position"']


@pytest.mark.parametrize(
    ("times", "trigger", "begins"),
    [
        (timing("relative"), after(1.0), 1.0),
        (timing("relative", offset=0.75), after(0.0), 0.75),
        (timing("relative", offset=0.25), after(0.5, delay=0.5), 1.25),
        (timing("absolute", offset=1.5), after(0.0), 1.5),
        (timing("absolute", offset=1.5), "", 1.5),
    ],
)
def test_until_its_first_time_an_entity_stays(times: str, trigger: str, begins: float) -> None:
    line = polyline((0.0, world(40, 5)), (1.0, world(50, 5)))
    where, said = lead(teleport(world(20)), event("e", follow(line, "position", times), trigger))
    assert where(begins - 0.01)[:2] == (20.0, 0.0) and where(begins + 0.5)[:2] == pytest.approx((45.0, 5.0))
    assert where(begins + 1.5)[0] == pytest.approx(55.0)  # goes on as it came to the end
    assert said == [f"entity 'lead': jumps by 20.6 m at {begins:.3g} s"]


def test_scaled_times_and_a_late_start() -> None:
    """An absolute trajectory that is started late goes on where it would be by then."""
    line = polyline((0.0, world(0)), (2.0, world(20)))
    where, _ = lead(teleport(world(5)), event("e", follow(line, "position", timing("absolute", scale=2.0)), after(1.0)))
    assert where(0.5)[0] == 5.0 and where(1.0)[0] == pytest.approx(5.0) and where(3.0)[0] == pytest.approx(15.0)


def test_what_begins_on_the_way_is_driven_to() -> None:
    """Until the trajectory begins, the entity drives at its speed; a speed given on the way ends the trajectory's times."""
    line = polyline((1.0, world(10)), (2.0, world(20)))
    events = event("t", follow(line, "position", timing())) + event("v", speed("2"), after(1.5))
    where, said = lead(teleport(world(0)) + speed("10"), events)
    assert [where(one)[0] for one in (0.5, 1.0, 1.5, 2.5)] == pytest.approx([5.0, 10.0, 15.0, 17.0], abs=1e-3)
    assert said == ["entity 'lead': an action on its speed ends its trajectory's times: it drives on along it"]


def test_an_offset_along_a_trajectory_and_one_that_is_closed() -> None:
    line = polyline((0.0, world(0)), (1.0, world(10)), (2.0, world(10, 10)))
    where, said = lead("", event("e", follow(line, "position", timing(), 'initialDistanceOffset="5"')))
    assert where(0.0)[0] == pytest.approx(5.0) and where(1.5)[:2] == pytest.approx((10.0, 10.0))
    assert said[0].endswith(
        "initialDistanceOffset: it starts 5 m along the trajectory, and is everywhere 0.5 s earlier"
    )
    where, said = lead("", event("e", follow(line, "position", timing(), closed="true")))
    assert where(2.0 + math.sqrt(2))[:2] == pytest.approx((0.0, 0.0), abs=1e-6) and 'closed="true"' in said[0]
    # without times the way counts
    where, _ = lead(speed("10"), event("e", follow(line, "follow", more='initialDistanceOffset="5"')))
    assert where(0.3)[:2] == pytest.approx((8.0, 0.0), abs=0.01) and where(1.0)[1] == pytest.approx(5.0, abs=0.01)


def test_what_goes_beyond_the_log_is_cut_there() -> None:
    line = polyline((0.0, world(0)), (8.0, world(80)))
    where, said = lead("", event("e", follow(line, "position", timing())))
    assert where(4.0)[0] == pytest.approx(40.0)
    assert said == ["entity 'lead': its trajectory goes on until 8 s: it is cut at the log's end, 4 s"]
    _, said = lead(teleport(world(5)), event("e", follow(line, "position", timing(offset=5.0))))
    assert said == ["entity 'lead': its trajectory begins at 5 s, after the log's end, 4 s: it is left out"]


def test_the_ego_stands_where_it_is_put() -> None:
    edits, said = read(written(entity("Ego"), start("Ego", teleport(world(5)))))
    (edit,) = edits["ego"]
    assert at(edit)(0.0) == at(edit)(4.0) == (5.0, 0.0, 0.0) and said == []


GLOBAL = '<GlobalAction><EntityAction entityRef="{}">{}</EntityAction></GlobalAction>'


def test_what_is_done_to_the_ego_is_done_or_said() -> None:
    delete = event("e", GLOBAL.format("Ego", "<DeleteEntityAction/>"), after(1.0))
    said = "entity 'Ego': DeleteEntityAction: the recording vehicle cannot vanish: it goes on as it was"
    edits, losses = read(written(entity("Ego"), start("Ego", teleport(world(5)), speed("2")), group("Ego", delete)))
    assert at(edits["ego"][0])(3.0)[0] == pytest.approx(11.0) and losses == [said]
    edits, losses = read(written(entity("Ego"), "", group("Ego", delete)))
    assert "ego" not in edits and losses == [said]
    add = GLOBAL.format("Ego", f"<AddEntityAction><Position>{world(30)}</Position></AddEntityAction>")
    edits, losses = read(written(entity("Ego"), "", group("Ego", event("e", add, after(1.0)))))
    assert at(edits["ego"][0])(0.5)[0] == pytest.approx(5.0, abs=1e-3) and at(edits["ego"][0])(2.0)[0] == pytest.approx(
        40.0
    )
    assert losses == [
        "entity 'Ego': AddEntityAction at 1 s: it is there already, and is put elsewhere",
        "entity 'Ego': jumps by 20 m at 1 s",
    ]


def test_deleted_and_added_again() -> None:
    add = f"<AddEntityAction><Position>{world(30)}</Position></AddEntityAction>"
    events = event("gone", GLOBAL.format("lead", "<DeleteEntityAction/>"), after(0.5))
    events += event("back", GLOBAL.format("lead", add), after(1.0)) + event("goes", speed("4"), after(2.0))
    edits, said = read(written(entity("lead"), start("lead", teleport(world(20))), group("lead", events)))
    first, second = edits["lead"]
    assert isinstance(first, Move) and isinstance(second, Duplicate) and second.id == "lead-2"
    assert first.present is not None and (first.present.start_s, first.present.end_s) == (None, 0.5)
    assert second.present is not None and (second.present.start_s, second.present.end_s) == (1.0, None)
    assert at(first)(0.0)[0] == 20.0 and at(second)(1.5)[0] == 30.0 and at(second)(3.0)[0] == pytest.approx(34.0)
    assert said == ["entity 'lead': it appears again at 1 s: as a duplicate of lead, lead-2"]
    # one that is deleted as the drive begins was never there, and one that is never added is not
    edits, said = read(written(entity("lead"), "", group("lead", events.replace('value="0.5"', 'value="0"'))))
    (only,) = edits["lead"]
    assert isinstance(only, Move) and only.present is not None and only.present.start_s == 1.0 and said == []
    late = event("back", GLOBAL.format("lead", add), after(9.0))
    edits, said = read(written(entity("lead"), "", group("lead", late)))
    assert isinstance(edits["lead"][0], Remove) and said == ["entity 'lead': it never appears"]


@pytest.mark.parametrize(
    ("dynamics", "places"),
    [
        ('dynamicsShape="linear" dynamicsDimension="time" value="2"', (0.0, 2.5, 10.0, 20.0)),
        ('dynamicsShape="linear" dynamicsDimension="rate" value="-5"', (0.0, 2.5, 10.0, 20.0)),
        ('dynamicsShape="linear" dynamicsDimension="distance" value="10"', (0.0, 2.5, 10.0, 20.0)),
        ('dynamicsShape="sinusoidal" dynamicsDimension="time" value="2"', (0.0, 5 - 10 / math.pi, 10.0, 20.0)),
        ('dynamicsShape="cubic" dynamicsDimension="rate" value="7.5"', (0.0, 1.875, 10.0, 20.0)),
        ('dynamicsShape="step" dynamicsDimension="time" value="0"', (0.0, 10.0, 20.0, 30.0)),
    ],
)
def test_dynamics_of_speeds(dynamics: str, places: tuple[float, ...]) -> None:
    """From 0 to 10 m/s: the way after 0, 1, 2 and 3 s is the integral of each shape."""
    where, said = lead(teleport(world(0)), event("e", speed("10", dynamics)))
    assert [where(one)[0] for one in (0.0, 1.0, 2.0, 3.0)] == pytest.approx(places, abs=0.01) and said == []


@pytest.mark.parametrize(("first", "after_1_s", "after_4_s"), [("0", 1.0, 16.0), ("6", 7.0, 36.0)])
def test_a_speed_that_changes_in_init(first: str, after_1_s: float, after_4_s: float) -> None:
    """At 2 m/s^2 up to 10 m/s, from rest and from 6 m/s, where the file has no event that the drive is looked at for."""
    faster = speed("10", 'dynamicsShape="linear" dynamicsDimension="rate" value="2"')
    text = written(entity("lead"), start("lead", teleport(world(0)), speed(first), faster))
    edits, said = read(text.replace('<Story name="s"><Act name="a"></Act></Story>', ""))
    where = at(edits["lead"][0])
    assert said == [] and where(4.0)[0] == pytest.approx(after_4_s, abs=0.02)
    assert where(1.0)[0] == pytest.approx(after_1_s, abs=0.02)


def test_speeds_beside_those_of_others() -> None:
    target = '<RelativeTargetSpeed entityRef="Ego" value="{}" speedTargetValueType="{}" continuous="{}"/>'
    both = entity("Ego") + entity("lead")
    for relation, moves, way in (("delta", "false", 4 * 12.0), ("factor", "true", 1.5 * (2 * 10.0 + 2 * 4.0))):
        chosen = speed(target.format("2" if relation == "delta" else "1.5", relation, moves))
        init = start("Ego", speed("10")) + start("lead", teleport(world(0)), chosen)
        edits, said = read(written(both, init, group("Ego", event("slow", speed("4"), after(2.0)))))
        assert at(edits["lead"][0])(4.0)[0] == pytest.approx(way, abs=0.1) and said == []


@pytest.mark.parametrize(
    ("entries", "limits"),
    [
        ('<SpeedProfileEntry time="1" speed="10"/><SpeedProfileEntry time="2" speed="4"/>', ""),
        (
            '<SpeedProfileEntry speed="10"/><SpeedProfileEntry speed="4"/>',
            '<DynamicConstraints maxAcceleration="10" maxDeceleration="3"/>',
        ),
    ],
)
def test_speed_profiles(entries: str, limits: str) -> None:
    """10 m/s after a second, 4 m/s after two more, by their times or by accelerations."""
    profile = f'<LongitudinalAction><SpeedProfileAction followingMode="position">{limits}{entries}</SpeedProfileAction>'
    where, said = lead(teleport(world(0, 30)), event("e", private(f"{profile}</LongitudinalAction>")))
    assert [where(one)[0] for one in (1.0, 3.0, 4.0)] == pytest.approx([5.0, 19.0, 23.0], abs=0.02) and said == []


def test_backward_and_against_the_recorded_path() -> None:
    """What is headed the other way does not drive along its recorded path, and a speed below 0 goes backward."""
    where, _ = lead(teleport(world(40, 0, f'h="{math.pi}"')) + speed("5"))
    assert where(2.0)[0] == pytest.approx(30.0) and abs(where(2.0)[2]) == pytest.approx(180.0)
    where, _ = lead(teleport(world(40)) + speed("-5"))
    assert where(2.0) == pytest.approx((30.0, 0.0, 0.0))


ROAD = "no road network is read: the recorded path of 'Ego' stands for road '0', its start for s = 50 m and -1.75 m left of the "
ROAD += "road's line; lanes are 3.5 m wide, traffic keeps to the right"


def test_lanes_beside_the_recorded_path() -> None:
    """Lanes lie 3.5 m apart, those of positive numbers go the other way, and positions beside others move with them."""
    names = ("Ego", "lead", "other")
    init = start("Ego", teleport(lane(50)), speed("10")) + start("lead", teleport(lane(70, 1)), speed("5"))
    beside = '<RelativeLanePosition entityRef="Ego" dLane="-1" ds="12" offset="0.5"/>'
    edits, said = read(written("".join(map(entity, names)), init + start("other", teleport(beside), speed("10"))))
    assert said == [ROAD]
    assert "ego" not in edits  # it is where it was recorded, at the same speed
    assert at(edits["lead"][0])(2.0) == pytest.approx((10.0, 3.5, 180.0))
    assert at(edits["other"][0])(2.0) == pytest.approx((32.0, -3.0, 0.0))


def test_what_needs_a_road_network_is_said() -> None:
    init = start("Ego", teleport(lane(50)), speed("10")) + start("lead", teleport(lane(7, -1, road=5)), speed("5"))
    edits, said = read(written(entity("Ego") + entity("lead"), init))
    assert said == [
        ROAD,
        "Init: lead: LanePosition on road '5' (it needs a road network: a recorded path stands for road '0' alone) is not "
        "understood",
        "entity 'lead': its place at the start is not known: it starts where it was recorded",
    ]
    assert "lead" not in edits


@pytest.mark.parametrize(
    ("position", "place"),
    [
        ('<RelativeObjectPosition entityRef="Ego" dx="6" dy="2"/>', (6.0, 2.0, 0.0)),
        ('<RelativeWorldPosition entityRef="Ego" dx="-3" dy="1"/>', (-3.0, 1.0, 0.0)),
        ('<RelativeRoadPosition entityRef="Ego" ds="8" dt="-2"/>', (8.0, -2.0, 0.0)),
        ('<RoadPosition roadId="0" s="60" t="-1.75"/>', (10.0, 0.0, 0.0)),
        (lane(60, -2, inside='<Orientation type="relative" h="1.5707963267948966"/>'), (10.0, -3.5, 90.0)),
        (lane(60, -2, inside='<Orientation type="absolute" h="0.5"/>'), (10.0, -3.5, math.degrees(0.5))),
    ],
)
def test_positions(position: str, place: tuple[float, float, float]) -> None:
    init = start("lead", teleport(position)) + start("Ego", teleport(lane(50)), speed("10"))
    edits, _ = read(written(entity("Ego") + entity("lead"), init))
    assert at(edits["lead"][0])(0.0) == pytest.approx(place)


def test_a_position_without_a_height_is_at_0_and_said_to_be() -> None:
    high = drive()
    high = replace(high, world_from_ego=straight(0, 0, 10, z=2.0))
    text = written(entity("Ego") + entity("lead"), start("lead", teleport('<WorldPosition x="5" y="3"/>')))
    found = edits_of(ElementTree.fromstring(text), high, Vehicle(), Path("by_hand.xosc"), {})
    assert found.losses[0] == "a WorldPosition without z has z = 0, where the recorded path of 'Ego' is at 2 m"
    assert at(found.edits[0])(0.0)[:2] == (5.0, 3.0)


def change(target: str, dynamics: str) -> str:
    return private(f"""<LateralAction><LaneChangeAction><LaneChangeActionDynamics {dynamics}/><LaneChangeTarget>{target}
</LaneChangeTarget></LaneChangeAction></LateralAction>""")


@pytest.mark.parametrize(
    ("shape", "quarter", "steepest"),
    [("linear", 0.25, 1.0), ("sinusoidal", (1 - math.sqrt(0.5)) / 2, math.pi / 2), ("cubic", 0.15625, 1.5)],
)
def test_lane_changes(shape: str, quarter: float, steepest: float) -> None:
    target = '<RelativeTargetLane entityRef="Ego" value="1"/>'
    dynamics = f'dynamicsShape="{shape}" dynamicsDimension="time" value="2"'
    init = start("Ego", teleport(lane(50)), speed("10"))
    edits, _ = read(written(entity("Ego"), init, group("Ego", event("e", change(target, dynamics), after(1.0)))))
    where = at(edits["ego"][0])
    assert [where(one)[1] for one in (1.0, 1.5, 2.0, 3.0, 4.0)] == pytest.approx(
        [0, 3.5 * quarter, 1.75, 3.5, 3.5], abs=0.03
    )
    # it is headed where it goes
    assert where(2.0)[2] == pytest.approx(math.degrees(math.atan2(1.75 * steepest, 10)), abs=0.6)
    assert where(3.5) == pytest.approx((35.0, 3.5, 0.0), abs=0.01)


def test_lane_changes_to_a_lane_and_of_those_who_come_the_other_way() -> None:
    """Lane 1 is left of lane -1 for the ego, and -1 is left of 1 for who drives there."""
    init = start("Ego", teleport(lane(50)), speed("10")) + start("lead", teleport(lane(80, 1)), speed("5"))
    dynamics = 'dynamicsShape="cubic" dynamicsDimension="distance" value="10"'
    groups = group("Ego", event("e", change('<AbsoluteTargetLane value="1"/>', dynamics)))
    groups += group("lead", event("f", change('<AbsoluteTargetLane value="-1"/>', 'dynamicsShape="step"')))
    edits, _ = read(written(entity("Ego") + entity("lead"), init, groups))
    assert at(edits["ego"][0])(0.5)[1] == pytest.approx(1.75, abs=0.05)
    assert at(edits["ego"][0])(2.0)[1] == pytest.approx(3.5)
    assert at(edits["lead"][0])(2.0) == pytest.approx((20.0, 0.0, 180.0))


@pytest.mark.parametrize(
    ("actor", "beside", "lanes", "y"),
    [
        ("lead", "lead", 1, 0.0),  # left of who comes the other way lies lane -1, without a lane 0 between
        ("lead", "lead", -1, 7.0),
        ("lead", "Ego", 1, 3.5),
        ("Ego", "lead", 1, 0.0),
        ("Ego", "lead", -1, 7.0),
        ("Ego", "Ego", -1, -3.5),
    ],
)
def test_relative_target_lanes_count_to_the_left_of_where_the_other_one_looks(
    actor: str, beside: str, lanes: int, y: float
) -> None:
    init = start("Ego", teleport(lane(50)), speed("10")) + start("lead", teleport(lane(80, 1)), speed("5"))
    step = change(f'<RelativeTargetLane entityRef="{beside}" value="{lanes}"/>', 'dynamicsShape="step"')
    edits, said = read(written(entity("Ego") + entity("lead"), init, group(actor, event("e", step, after(0.5)))))
    ends = at(edits[actor.lower()][0])(2.0) if actor.lower() in edits else (20.0, 0.0, 0.0)
    assert ends == pytest.approx((20.0, y, 180.0 if actor == "lead" else 0.0))
    assert all(one == ROAD or "jumps" in one for one in said)


@pytest.mark.parametrize(
    ("position", "x"),
    [
        ('<RelativeLanePosition entityRef="lead" dLane="0" ds="12"/>', 42.0),
        ('<RelativeLanePosition entityRef="lead" dLane="0" dsLane="12"/>', 18.0),
        ('<RelativeRoadPosition entityRef="lead" ds="12" dt="0"/>', 42.0),
    ],
)
def test_ways_beside_who_drives_against_its_road(position: str, x: float) -> None:
    """``ds`` is along the road, which runs as the ego drives, ``dsLane`` is as the lane is driven."""
    init = start("Ego", teleport(lane(50)), speed("10")) + start("lead", teleport(lane(80, 1)))
    edits, _ = read(written("".join(map(entity, ("Ego", "lead", "other"))), init + start("other", teleport(position))))
    assert at(edits["other"][0])(0.0) == pytest.approx((x, 3.5, 180.0))


@pytest.mark.parametrize(
    ("rule", "position", "place"),
    [
        # where traffic keeps to the left, lane 3 is driven along the road, and lane 2 is right of it
        (' rule="LHT"', '<RelativeLanePosition entityRef="Ego" dLane="-1" ds="-30"/>', (-30.0, -3.5, 0.0)),
        (' rule="LHT"', '<RelativeLanePosition entityRef="Ego" dLane="-1" dsLane="-30"/>', (-30.0, -3.5, 0.0)),
        (' rule="LHT"', '<RelativeRoadPosition entityRef="Ego" ds="-30" dt="-3.5"/>', (-30.0, -3.5, 0.0)),
        (' rule="LHT"', lane(70, -1), (30.0, -10.5, 180.0)),
        (' rule="LHT"', lane(70, 1), (30.0, -7.0, 0.0)),
        # where it keeps to the right, lane 3 is driven against the road, and lane 2 is left of it
        (' rule="RHT"', '<RelativeLanePosition entityRef="Ego" dLane="-1" ds="-30"/>', (30.0, 3.5, 0.0)),
        (' rule="RHT"', '<RelativeLanePosition entityRef="Ego" dLane="-1" dsLane="-30"/>', (-30.0, 3.5, 0.0)),
        (' rule="RHT"', '<RelativeRoadPosition entityRef="Ego" ds="-30" dt="-3.5"/>', (30.0, 3.5, 0.0)),
        (' rule="RHT"', lane(10, -1), (30.0, 10.5, 180.0)),
        ("", lane(10, 1), (30.0, 7.0, 0.0)),
    ],
)
def test_the_side_that_traffic_keeps_to_is_that_of_the_road(
    tmp_path: Path, rule: str, position: str, place: tuple[float, float, float]
) -> None:
    """The ego is at s = 40 m in lane 3, whose middle is 8.75 m left of the road's line; road 1 is another one."""
    (tmp_path / "roads.xodr").write_text(f'<OpenDRIVE><road id="1" rule="LHT"/><road id="0"{rule}/></OpenDRIVE>')
    init = start("Ego", teleport(lane(40, 3)), speed("10")) + start("lead", teleport(position), speed("0"))
    head = '<RoadNetwork><LogicFile filepath="roads.xodr"/></RoadNetwork>'
    edits, said = read(written(entity("Ego") + entity("lead"), init, head=head), tmp_path / "by_hand.xosc")
    assert at(edits["lead"][0])(0.0) == pytest.approx(place)
    side = "left" if "LHT" in rule else "right"
    assert said[0].endswith(f"lanes are 3.5 m wide, traffic keeps to the {side}")
    assert not any("LogicFile" in one for one in said)


@pytest.mark.parametrize(
    ("content", "fault"), [(None, "cannot be read: No such file or directory"), ("<OpenDRIVE>", "is no XML: ")]
)
def test_a_road_network_that_cannot_be_read_is_said(tmp_path: Path, content: str | None, fault: str) -> None:
    file = tmp_path / "roads.xodr"
    if content is not None:
        file.write_text(content)
    head = '<RoadNetwork><LogicFile filepath="roads.xodr"/></RoadNetwork>'
    text = written(entity("Ego"), start("Ego", teleport(lane(50)), speed("10")), head=head)
    _, said = read(text, tmp_path / "by_hand.xosc")
    assert said[0].startswith(f"RoadNetwork: LogicFile: {file}: {fault}")
    assert said[0].endswith(": traffic is taken to keep to the right") and said[1:] == [ROAD]


@pytest.mark.parametrize(
    ("inside", "heading"),
    [
        ("", 0.0),
        ('<Orientation type="relative" h="3.141593"/>', 0.0),
        ('<Orientation type="relative" h="0"/>', 180.0),
    ],
)
@pytest.mark.parametrize("number", [3, -3])
def test_a_relative_heading_beside_who_is_turned_round_counts_from_its_lane(
    number: int, inside: str, heading: float
) -> None:
    """Both are turned round in lanes 3 and 2, or -3 and -2, the second right of the first, and so drive the same way; without an
    Orientation they do, too."""
    turned = lane(100, number, inside='<Orientation type="relative" h="3.141593"/>')
    by, ds = (-1, -30) if number > 0 else (1, 30)
    beside = f'<RelativeLanePosition entityRef="Ego" dLane="{by}" ds="{ds}">{inside}</RelativeLanePosition>'
    init = start("Ego", teleport(turned), speed("10")) + start("lead", teleport(beside), speed("5"))
    edits, said = read(written(entity("Ego") + entity("lead"), init))
    where, ahead = at(edits["lead"][0]), 1 if heading == 0 else -1
    for time in (0.0, 2.0):
        x, left, turn = where(time)
        assert (x, left) == pytest.approx((-30.0 + ahead * 5 * time, -3.5), abs=1e-4)
        assert math.cos(math.radians(turn)) == pytest.approx(ahead)
    assert any("'Ego' drives against its lane's traffic" in one for one in said) == (inside != "")


RADIUS_M = 40.0


def bending(heading: float) -> Drive:
    """The ego at 10 m/s from the origin, headed so at first, along a left arc of 40 m."""
    times = np.linspace(0.0, END_S, 41)
    angles = heading + 10 * times / RADIUS_M
    x = RADIUS_M * (np.sin(angles) - math.sin(heading))
    y = RADIUS_M * (math.cos(heading) - np.cos(angles))
    ego = Trajectory(times, np.stack([x, y, np.zeros(41)], 1), quaternion_from_yaw(angles))
    return replace(drive(), world_from_ego=ego)


def absolute(h: float) -> str:
    return f'<Orientation type="absolute" h="{h}"/>'


@pytest.mark.parametrize("begins", [0.0, 2.0])
@pytest.mark.parametrize(
    ("own", "stated", "turned"),
    [
        (absolute(0.7), 0.7, 0.0),
        (absolute(0.7), 0.9, 0.0),  # its road may bend, too
        (absolute(0.7), 0.7 - math.pi, math.pi),
        (absolute(0.7), 0.7 + math.pi / 2, math.pi / 2),
        (absolute(0.7), 0.7 - math.pi / 2 - 1e-6, -math.pi / 2),
        ("", None, 0.0),
    ],
)
def test_an_absolute_heading_in_a_lane_is_beside_that_of_the_road(
    begins: float, own: str, stated: float | None, turned: float
) -> None:
    """Whatever the log's headings are, who looks along the road of the file drives along the recorded path, with no angle to it;
    who looks across it does so further on, and drives on along its lane."""
    log = bending(begins)
    stated = begins if stated is None else stated
    there = lane(70, inside=absolute(stated))
    init = start("Ego", teleport(lane(50, inside=own)), speed("10")) + start("lead", teleport(there), speed("5"))
    text = written(entity("Ego") + entity("lead"), init)
    found = edits_of(ElementTree.fromstring(text), log, Vehicle(), Path("by_hand.xosc"), {})
    where = at(next(edit for edit in found.edits if plain(edit).get("actor") == "lead"))
    back = abs(turned) == math.pi
    for time in (0.0, 1.0, 2.0):
        angle = begins + (20 + (-5 if back else 5) * time) / RADIUS_M
        x, y, heading = where(time)
        assert x == pytest.approx(RADIUS_M * (math.sin(angle) - math.sin(begins)), abs=0.05)
        assert y == pytest.approx(RADIUS_M * (math.cos(begins) - math.cos(angle)), abs=0.05)
        assert abs(math.remainder(math.radians(heading) - angle - turned, math.tau)) < 0.01
    across = abs(turned) == math.pi / 2
    said = f"its absolute heading is {math.degrees(turned):.0f}° off that of the traffic where road '0' is anchored"
    assert [said in one for one in found.losses if "absolute heading" in one] == [True] * across


@pytest.mark.parametrize("h", [0.0, 1.5707, 1.5709, -1.5708])
@pytest.mark.parametrize(
    "position",
    [
        '<RelativeObjectPosition entityRef="lead" dx="0" dy="0">{}</RelativeObjectPosition>',
        '<RelativeWorldPosition entityRef="lead" dx="0" dy="0">{}</RelativeWorldPosition>',
        '<RelativeLanePosition entityRef="lead" dLane="0" ds="0">{}</RelativeLanePosition>',
        '<RelativeRoadPosition entityRef="lead" ds="0" dt="0">{}</RelativeRoadPosition>',
    ],
)
def test_who_is_put_beside_itself_keeps_its_way(position: str, h: float) -> None:
    """Turned or not, it goes on along its path, here a trajectory, at its speed."""
    line = polyline((None, world(0)), (None, world(5)), (None, world(5, 30)))
    turn = teleport(position.format(f'<Orientation type="relative" h="{h}"/>'))
    events = event("goes", follow(line)) + event("turns", turn, after(2.0))
    where, said = lead(teleport(world(0)) + speed("5"), events)
    assert where(1.0) == pytest.approx((5.0, 0.0, 45.0), abs=0.1)
    x, y, heading = where(3.0)
    assert (x, y) == pytest.approx((5.0, 10.0), abs=0.1) and said == []
    assert math.remainder(heading - 90 - math.degrees(h), 360) == pytest.approx(0.0, abs=0.1)


def test_who_is_put_ahead_of_itself_stays_on_its_path() -> None:
    line = polyline((None, world(0)), (None, world(5)), (None, world(5, 30)))
    ahead = teleport('<RelativeObjectPosition entityRef="lead" dx="10" dy="0"/>')
    where, _ = lead(teleport(world(0)) + speed("5"), event("goes", follow(line)) + event("on", ahead, after(2.0)))
    assert where(3.0) == pytest.approx((5.0, 20.0, 90.0), abs=0.1)
    # turned round, it drives back
    turned = '<Orientation type="relative" h="3.14"/>'
    back = teleport(f'<RelativeObjectPosition entityRef="lead" dx="0" dy="0">{turned}</RelativeObjectPosition>')
    where, _ = lead(teleport(world(0)) + speed("5"), event("goes", follow(line)) + event("back", back, after(2.0)))
    assert where(2.8)[:2] == pytest.approx((5.0, 1.0), abs=0.1)


@pytest.mark.parametrize(("second", "number", "s"), [(90, -1, 70), (20, 1, 30)])
def test_a_place_on_a_route_in_lanes_anchors_the_road_of_its_first_waypoint(second: int, number: int, s: int) -> None:
    """20 m along the route from s = 50 m, towards its second waypoint; "lead" is 10 m further along the road."""
    ways = "".join(
        f'<Waypoint routeStrategy="shortest"><Position>{lane(one, number)}</Position></Waypoint>'
        for one in (50, second)
    )
    on_route = f"""<RoutePosition><RouteRef><Route name="r" closed="false">{ways}</Route></RouteRef><InRoutePosition>
<FromLaneCoordinates pathS="20" laneId="{number}"/></InRoutePosition></RoutePosition>"""
    init = start("Ego", teleport(on_route), speed("10")) + start("lead", teleport(lane(s + 10, number)))
    edits, said = read(written(entity("Ego") + entity("lead"), init))
    assert "ego" not in edits and at(edits["lead"][0])(0.0) == pytest.approx((10.0 if second > 50 else -10.0, 0.0, 0.0))
    assert any("pathS counts along road '0'" in one for one in said)


def test_a_total_below_0_is_said() -> None:
    trigger = of_entity("lead", '<SpeedCondition value="-1" rule="lessThan"/>')
    where, said = lead(teleport(world(20)) + speed("-2"), event("e", speed("5"), trigger))
    assert where(2.0)[0] == pytest.approx(16.0)
    assert said == [
        "s/a/e: StartTrigger: SpeedCondition with -1 and without a direction: the total is compared, which is never below 0"
    ]


@pytest.mark.parametrize("number", [-1, 1])
def test_every_position_off_the_recorded_path_is_said(number: int) -> None:
    """With its entity and the end that it is off, one beside another, and one that drives the other way, too."""
    path = "the recorded path of 40 m, which is straight there"
    init = (
        start("Ego", teleport(lane(50)), speed("10"))
        + start("lead", teleport(lane(100, number)))
        + start("other", teleport('<RelativeLanePosition entityRef="lead" dLane="0" ds="-58"/>'))
    )
    _, said = read(written("".join(map(entity, ("Ego", "lead", "other"))), init))
    assert said[1:] == [
        f"Init: lead: LanePosition: lies 10 m beyond the end of {path}",
        f"Init: other: RelativeLanePosition: lies 8 m before the start of {path}",
    ]


def test_an_offset_in_its_lane() -> None:
    """0.4 m with at most 0.6 m/s² take 2 s as a cubic: half of it after one."""
    action = private("""<LateralAction><LaneOffsetAction continuous="false"><LaneOffsetActionDynamics dynamicsShape="cubic"
maxLateralAcc="0.6"/><LaneOffsetTarget><AbsoluteTargetLaneOffset value="-0.4"/></LaneOffsetTarget></LaneOffsetAction>
</LateralAction>""")
    where, said = lead(teleport(world(0, 30)) + speed("10"), event("e", action))
    assert [where(one)[1] for one in (0.0, 1.0, 2.5)] == pytest.approx([30.0, 29.8, 29.6], abs=0.01) and said == []


NEAR = (
    '<RelativeDistanceCondition entityRef="lead" relativeDistanceType="{}" freespace="{}" value="{}" rule="lessThan"/>'
)
HEADWAY = '<TimeHeadwayCondition entityRef="lead" value="2" freespace="{}" rule="lessThan"/>'
COLLISION = """<TimeToCollisionCondition value="3" freespace="{}" rule="lessThan"><TimeToCollisionConditionTarget>
<EntityRef entityRef="lead"/></TimeToCollisionConditionTarget></TimeToCollisionCondition>"""


@pytest.mark.parametrize(
    ("ask", "met_s"),
    [
        # boxes reach 2 m before and behind their reference points
        (NEAR.format("longitudinal", "false", 30), 2.0),
        (NEAR.format("longitudinal", "true", 30), 1.2),
        (NEAR.format("euclidianDistance", "false", 35), 1.0),
        (HEADWAY.format("false"), 4.0 - 0.02),
        (HEADWAY.format("true"), 3.2),
        (COLLISION.format("true"), 4.2),
        (f'<ReachPositionCondition tolerance="1"><Position>{world(16)}</Position></ReachPositionCondition>', 1.5),
        (f'<DistanceCondition value="12" rule="lessOrEqual"><Position>{world(20)}</Position></DistanceCondition>', 0.8),
        ('<TraveledDistanceCondition value="25"/>', 2.5),
        ('<SpeedCondition value="9" rule="greaterThan"/>', 0.0),
        ('<RelativeSpeedCondition entityRef="lead" value="4" rule="greaterThan"/>', 0.0),
        ('<StandStillCondition duration="1"/>', 99.0),
        ('<AccelerationCondition value="0.5" rule="lessThan"/>', 0.0),
    ],
)  # fmt: skip
def test_conditions(ask: str, met_s: float) -> None:
    """The ego at 10 m/s 40 m behind a car at 5 m/s; "other" stands at 100 m until the condition is met, then goes at 10 m/s."""
    init = start("Ego", speed("10")) + start("lead", speed("5")) + start("other", teleport(world(100, 30)))
    everybody = "".join(map(entity, ("Ego", "lead", "other")))
    groups = group("other", event("e", speed("10"), of_entity("Ego", ask)))
    edits, said = read(written(everybody, init, groups))
    gone = at(edits["other"][0])(END_S)[0] - 100
    assert said == [] and gone == pytest.approx(max(END_S - met_s, 0) * 10, abs=0.41)


def test_edges_delays_and_states() -> None:
    """A condition that is met from the start has no edge; events start after others, and after their delay."""
    rising = of_entity("lead", '<SpeedCondition value="99" rule="lessThan"/>', edge="rising")
    state = '<ByValueCondition><StoryboardElementStateCondition storyboardElementType="{}" storyboardElementRef="{}" state="{}"/>'
    state += "</ByValueCondition>"
    events = event("never", speed("50"), rising)
    events += event("first", speed("4", 'dynamicsShape="linear" dynamicsDimension="time" value="1"'), after(0.5))
    events += event("second", speed("0"), condition(state.format("event", "first", "completeState"), delay=0.5))
    events += event("third", speed("10"), condition(state.format("action", "s::a::g::lead maneuver::second::second action",
                                                                 "endTransition"), delay=1.0))  # fmt: skip
    where, said = lead(teleport(world(0, 30)), events)
    assert [where(one)[0] for one in (0.5, 1.5, 2.0, 3.0, 4.0)] == pytest.approx(
        [0, 2, 4, 4, 14], abs=0.1
    ) and said == []


def test_variables_and_a_stop() -> None:
    head = (
        '<VariableDeclarations><VariableDeclaration name="v" variableType="double" value="1"/></VariableDeclarations>'
    )
    sets = (
        '<GlobalAction><VariableAction variableRef="v"><ModifyAction><Rule><AddValue value="2"/></Rule></ModifyAction>'
    )
    sets += "</VariableAction></GlobalAction>"
    ask = '<ByValueCondition><VariableCondition variableRef="v" rule="equalTo" value="3"/></ByValueCondition>'
    events = event("sets", sets, after(1.0)) + event("goes", speed("10"), condition(ask))
    act = after(3.0).replace("StartTrigger", "StopTrigger")
    for one in (events, events.replace('Ref="v"', 'Ref="$v"')):
        where, _ = lead(teleport(world(0, 30)), one, head=head, act=act)
        assert where(1.0)[0] == 0.0 and where(2.0)[0] == pytest.approx(10.0, abs=0.2)
    # an act that has stopped leaves its entities as they go, and starts nothing more
    late = event("late", speed("0"), after(3.5))
    where, _ = lead(teleport(world(0, 30)) + speed("10"), late, act=act)
    assert where(4.0)[0] == pytest.approx(40.0)


def test_an_event_that_overrides_stops_others() -> None:
    slowly = speed("10", 'dynamicsShape="linear" dynamicsDimension="time" value="4"')
    aside = change(
        '<RelativeTargetLane entityRef="lead" value="1"/>', 'dynamicsShape="linear" dynamicsDimension="time" value="4"'
    )
    events = event("first", slowly) + event("second", aside, after(2.0), priority="override")
    where, _ = lead(teleport(world(0, 30)), events)
    assert where(3.0)[0] - where(2.0)[0] == pytest.approx(5.0, abs=0.05)  # 5 m/s, as when it was overridden


def test_a_gap_is_kept_and_two_arrive_together() -> None:
    gap = private("""<LongitudinalAction><LongitudinalDistanceAction entityRef="Ego" distance="12" freespace="true"
continuous="{}" displacement="leadingReferencedEntity"/></LongitudinalAction>""")
    both = entity("Ego") + entity("lead")
    for continuous in ("false", "true"):
        init = start("Ego", speed("10")) + start("lead", teleport(world(50)), speed("10"))
        edits, _ = read(written(both, init, group("lead", event("e", gap.format(continuous), after(1.0)))))
        # between boxes of 4 m, 16 m between their middles
        assert at(edits["lead"][0])(2.0)[0] == pytest.approx(20 + 16, abs=0.01)
    meet = private("""<SynchronizeAction masterEntityRef="Ego"><TargetPositionMaster><WorldPosition x="30" y="0"/>
</TargetPositionMaster><TargetPosition><WorldPosition x="30" y="0"/></TargetPosition><FinalSpeed><AbsoluteSpeed value="2">
<TargetDistanceSteadyState distance="2"/></AbsoluteSpeed></FinalSpeed></SynchronizeAction>""")
    init = start("Ego", speed("10")) + start("lead", teleport(world(30, -5, f'h="{math.pi / 2}"')))
    edits, _ = read(written(both, init, group("lead", event("e", meet))))
    where = at(edits["lead"][0])
    # 3 m with speeds that come to 2 m/s at 2 s, then 2 m at 2 m/s
    assert where(2.0)[1] == pytest.approx(-2.0, abs=0.1) and where(3.0)[1] == pytest.approx(0.0, abs=0.1)


def meeting(own: float, masters: float, final: str = "") -> str:
    return private(f"""<SynchronizeAction masterEntityRef="Ego"><TargetPositionMaster>{world(masters)}</TargetPositionMaster>
<TargetPosition>{world(own)}</TargetPosition>{final}</SynchronizeAction>""")


FINAL = '<FinalSpeed><AbsoluteSpeed value="6"/></FinalSpeed>'


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("final", ["", FINAL])
@pytest.mark.parametrize("first", ["Ego", "lead"])
def test_two_arrive_together_without_a_jump_of_speed(first: str, final: str, turned: bool) -> None:
    """At 30 m after three seconds, whoever stands first in the file; also beside one that backs there."""
    second = "lead" if first == "Ego" else "Ego"
    init = start("Ego", teleport(world(0, 20, f'h="{math.pi if turned else 0}"')), speed("-10" if turned else "10"))
    init += start("lead", teleport(world(9, 40)), speed("5"))
    # y does not count along straight paths
    edits, said = read(written(entity(first) + entity(second), init, group("lead", event("e", meeting(30, 30, final)))))
    where = at(edits["lead"][0])
    assert where(3.0)[0] == pytest.approx(30.0, abs=0.02) and said == []
    speeds = [(where(time + 0.1)[0] - where(time)[0]) / 0.1 for time in np.arange(0, 2.95, 0.1).tolist()]
    assert speeds[0] == pytest.approx(5.0, abs=0.6) and np.abs(np.diff(speeds)).max() < 0.9
    if final:
        assert speeds[-1] == pytest.approx(6.0, abs=0.4)


@pytest.mark.parametrize("first", ["Ego", "lead"])
def test_a_gap_does_not_depend_on_who_stands_first(first: str) -> None:
    second = "lead" if first == "Ego" else "Ego"
    gap = private("""<LongitudinalAction><LongitudinalDistanceAction entityRef="Ego" distance="12" freespace="false"
continuous="true" displacement="leadingReferencedEntity"><DynamicConstraints maxAcceleration="5" maxDeceleration="5"/>
</LongitudinalDistanceAction></LongitudinalAction>""")
    init = start("Ego", teleport(world(0, 20)), speed("10")) + start("lead", teleport(world(12, 20)), speed("10"))
    edits, _ = read(written(entity(first) + entity(second), init, group("lead", event("e", gap))))
    assert at(edits["lead"][0])(4.0)[0] == pytest.approx(52.0, abs=1e-6)


def test_every_place_of_a_sentence_is_given() -> None:
    """An action that is lost is, beside a position at the start that is for the same reason."""
    lost = lane(5, road=7)
    init = start("Ego", teleport(lane(50)), speed("10")) + start("lead", teleport(lost))
    meets = meeting(9, 9).replace(world(9), lost)
    _, said = read(written(entity("Ego") + entity("lead"), init, group("lead", event("e", meets))))
    assert said[1].startswith("Init: lead: LanePosition") and said[1].endswith("(and at s/a/e/e action)")


def test_a_distance_to_the_side_within_an_acceleration() -> None:
    """6 m with 1.5 m/s²: 2 s to the middle and 2 s to the end."""
    beside = private("""<LateralAction><LateralDistanceAction entityRef="Ego" distance="3" freespace="false" continuous="false"
displacement="leftToReferencedEntity"><DynamicConstraints maxAcceleration="1.5"/></LateralDistanceAction></LateralAction>""")
    init = start("Ego", teleport(lane(50)), speed("10")) + start("lead", teleport(world(0, 9)), speed("10"))
    edits, said = read(written(entity("Ego") + entity("lead"), init, group("lead", event("e", beside))))
    where = at(edits["lead"][0])
    assert [where(time)[1] for time in (0.0, 1.0, 2.0, 4.0)] == pytest.approx([9.0, 8.25, 6.0, 3.0], abs=0.1)
    assert said == [ROAD]


def test_the_box_that_the_recording_vehicle_keeps_is_said() -> None:
    found = edits_of(ElementTree.fromstring(written(entity("Ego"), "")), drive(), Vehicle(), Path("by_hand.xosc"), {})
    assert [one for one in found.losses if one.startswith("entity 'Ego': its box of 4 x 2 x 1.5 m is not read")]


def test_a_distance_to_the_side_is_kept() -> None:
    """1 m between boxes of 2 m is 3 m between their middles, reached at 2 m/s; without a limit it is there at once."""
    beside = private("""<LateralAction><LateralDistanceAction entityRef="Ego" distance="1" freespace="true" continuous="true"
displacement="leftToReferencedEntity">{}</LateralDistanceAction></LateralAction>""")
    init = start("Ego", teleport(lane(50)), speed("10")) + start("lead", teleport(world(0, 9)), speed("10"))
    for limit, after_1_s in (('<DynamicConstraints maxSpeed="2"/>', 7.0), ("", 3.0)):
        groups = group("lead", event("e", beside.format(limit)))
        edits, said = read(written(entity("Ego") + entity("lead"), init, groups))
        assert at(edits["lead"][0])(1.0)[1] == pytest.approx(after_1_s, abs=0.05)
        assert at(edits["lead"][0])(4.0)[1] == pytest.approx(3.0) and said == [ROAD]
    # another distance, taken at once, is the last one that is kept
    once = beside.format("").replace('distance="1"', 'distance="4"').replace('continuous="true"', 'continuous="false"')
    groups = group(
        "lead", event("e", beside.format('<DynamicConstraints maxSpeed="9"/>')) + event("f", once, after(2.0))
    )
    edits, _ = read(written(entity("Ego") + entity("lead"), init, groups))
    assert at(edits["lead"][0])(1.5)[1] == pytest.approx(3.0) and at(edits["lead"][0])(3.0)[1] == pytest.approx(6.0)


def test_an_ego_that_is_turned_round_in_its_lane() -> None:
    """In lane 3 and turned, it drives along the road, where lower numbers lie to its right."""
    turned = f'<Orientation type="relative" h="{math.pi}"/>'
    init = start("Ego", teleport(lane(40, 3, inside=turned)), speed("10"))
    init += start("lead", teleport('<RelativeLanePosition entityRef="Ego" dLane="-1" ds="15"/>'), speed("10"))
    init += start("other", teleport(lane(60, 2)), speed("10"))
    edits, said = read(written("".join(map(entity, ("Ego", "lead", "other"))), init))
    assert len(said) == 1 and "ego" not in edits
    assert at(edits["lead"][0])(1.0) == pytest.approx((25.0, -3.5, 0.0))
    assert at(edits["other"][0])(1.0) == pytest.approx((10.0, -3.5, 180.0))


def test_stories_run_from_the_start() -> None:
    state = """<ByValueCondition><StoryboardElementStateCondition storyboardElementType="story" storyboardElementRef="s"
state="runningState"/></ByValueCondition>"""
    where, said = lead(teleport(world(0, 30)), event("e", speed("5")), act=condition(state))
    assert where(2.0)[0] == pytest.approx(10.0) and said == []


ARC = f'<Clothoid curvature="0.1" curvaturePrime="0" length="{5 * math.pi}"><Position>{world(0)}</Position></Clothoid>'
SPLINE = f"""<ClothoidSpline><ClothoidSplineSegment curvatureStart="0" curvatureEnd="0" length="4"><PositionStart>{world(0)}
</PositionStart></ClothoidSplineSegment><ClothoidSplineSegment curvatureStart="0" curvatureEnd="0" length="9"
hOffset="{math.pi / 2}"/></ClothoidSpline>"""
WEIGHT = math.sqrt(0.5)
QUARTER = '<Nurbs order="3">' + "".join(
    f'<ControlPoint weight="{weight}"><Position>{world(x, y)}</Position></ControlPoint>'
    for weight, x, y in ((1, 10, 0), (WEIGHT, 10, 10), (1, 0, 10))
)
QUARTER += "".join(f'<Knot value="{one}"/>' for one in (0, 0, 0, 1, 1, 1)) + "</Nurbs>"


@pytest.mark.parametrize(
    ("line", "time_s", "place"),
    [
        (ARC, 2.5, (10 * math.sin(1.25), 10 * (1 - math.cos(1.25)), math.degrees(1.25))),
        (SPLINE, 2.0, (4.0, 6.0, 90.0)),
        (QUARTER, 2.5, (10 * math.cos(1.25), 10 * math.sin(1.25), math.degrees(1.25) + 90)),
    ],
)
def test_curves(line: str, time_s: float, place: tuple[float, float, float]) -> None:
    """At 5 m/s along a circle of 10 m, round a corner, and along a quarter of a circle as a spline."""
    where, said = lead(speed("5"), event("e", follow(line)))
    assert where(time_s) == pytest.approx(place, abs=0.1)
    assert all("jumps" in one for one in said)


def test_a_spline_with_times() -> None:
    """A straight one from 0 to 30 m: at its middle half of its time is over."""
    points = "".join(
        f'<ControlPoint time="{time}" weight="1"><Position>{world(x)}</Position></ControlPoint>'
        for time, x in ((0, 0), (1, 10), (2, 20), (3, 30))
    )
    knots = "".join(f'<Knot value="{one}"/>' for one in (0, 0, 0, 0, 1, 1, 1, 1))
    where, said = lead("", event("e", follow(f'<Nurbs order="4">{points}{knots}</Nurbs>', "follow", timing())))
    assert [where(one)[0] for one in (0.0, 1.5, 3.0)] == pytest.approx([0.0, 15.0, 30.0], abs=0.01) and said == []


def test_routes() -> None:
    route = f"""<RoutingAction><AssignRouteAction><Route name="r" closed="false"><Waypoint routeStrategy="shortest"><Position>
{world(10)}</Position></Waypoint><Waypoint routeStrategy="shortest"><Position>{world(10, 20)}</Position></Waypoint></Route>
</AssignRouteAction></RoutingAction>"""
    where, said = lead(teleport(world(0)) + speed("5"), event("e", private(route)))
    assert where(1.0) == pytest.approx((5.0, 0.0, 0.0)) and where(3.0) == pytest.approx((10.0, 5.0, 90.0), abs=0.01)
    assert said == [
        "s/a/e/e action: AssignRouteAction: it drives straight from waypoint to waypoint: no road network is read",
        "Waypoint: not read: routeStrategy='shortest' (2 times)",
    ]


def test_parameters_of_every_level_and_catalogs(tmp_path: Path) -> None:
    """Those of the file, of the story, of a maneuver, and what a reference gives to an entry of a catalog."""
    catalog = f"""<OpenSCENARIO><FileHeader revMajor="1" revMinor="3"/><Catalog name="goes"><Maneuver name="goes">
<ParameterDeclarations><ParameterDeclaration name="v" parameterType="double" value="1"/><ParameterDeclaration name="w"
parameterType="double" value="${{$v * 2}}"/></ParameterDeclarations>{event("e", speed("$w"))}</Maneuver></Catalog>
</OpenSCENARIO>"""
    boxes = """<?xml version="1.2"?><OpenSCENARIO><FileHeader revMajor="1" revMinor="0"/><Catalog name="cars"><Vehicle name="car"
vehicleCategory="car"><BoundingBox><Center x="1.5" y="0" z="0.75"/><Dimensions width="2" length="4" height="1.5"/>
</BoundingBox></Vehicle></Catalog></OpenSCENARIO>"""
    (tmp_path / "goes.xosc").write_text(catalog)
    (tmp_path / "cars.xosc").write_text(boxes)
    head = '<CatalogLocations><ManeuverCatalog><Directory path="."/></ManeuverCatalog></CatalogLocations>'
    given = """<ManeuverGroup name="g" maximumExecutionCount="1"><Actors selectTriggeringEntities="false"><EntityRef
entityRef="$owner"/></Actors><CatalogReference catalogName="goes" entryName="goes"><ParameterAssignments><ParameterAssignment
parameterRef="v" value="${$fast / 2}"/></ParameterAssignments></CatalogReference></ManeuverGroup>"""
    declared = '<ParameterDeclaration name="{}" parameterType="double" value="{}"/>'
    text = written(
        '<ScenarioObject name="lead"><CatalogReference catalogName="cars" entryName="car"/></ScenarioObject>',
        start("lead", teleport(world(0, 30))), given, declared.format("fast", "${30 / 3}"), head,
    ).replace('<Story name="s">', f'<Story name="s"><ParameterDeclarations>{declared.format("owner", "lead")}'
              "</ParameterDeclarations>")  # fmt: skip
    # a name with $ before it is the same, also where a parameter of that name is in scope
    other = text.replace('parameterRef="v"', 'parameterRef="$v"')
    for one in (text, other, other.replace("</Para", declared.format("v", "9") + "</Para", 1)):
        edits, said = read(one, tmp_path / "file.xosc")
        assert said == [] and at(edits["lead"][0])(2.0)[0] == pytest.approx(21.5)  # its box's middle is 1.5 m ahead
    text = text.replace('entryName="goes"', 'entryName="comes"')
    assert read(text, tmp_path / "file.xosc")[1] == [
        "s/a/g: CatalogReference to 'comes' of the catalog 'goes' (which no file of CatalogLocations has) is not understood"
    ]


def test_an_expression_that_has_no_value_is_listed() -> None:
    where, said = lead(
        teleport(world(7)) + speed("${1 / $none}"), parameters='<ParameterDeclaration name="none" value="0"/>'
    )
    assert where(1.0)[0] == 7.0 and len(said) == 1
    assert said[0].endswith("value: the expression '${1 / $none}' (it divides by 0) is not understood")


@pytest.mark.parametrize(
    ("action", "sentence"),
    [
        (speed("$fast"), "AbsoluteTargetSpeed: value: the expression '$fast' (there is no parameter '$fast')"),
        (speed("3", 'dynamicsShape="linear" dynamicsDimension="time"'), "SpeedActionDynamics without value"),
        (
            speed("3", 'dynamicsShape="round" dynamicsDimension="time"'),
            "SpeedActionDynamics with the dynamicsShape 'round'",
        ),
        (private("<AppearanceAction><LightStateAction/></AppearanceAction>"), "LightStateAction"),
        (
            "<GlobalAction><TrafficAction><TrafficSinkAction radius='1'><Position>" + lane(9) + "</Position>"
            "</TrafficSinkAction></TrafficAction></GlobalAction>",
            "TrafficSinkAction",
        ),
    ],
)
def test_an_action_that_is_not_understood_is_left_out(action: str, sentence: str) -> None:
    where, said = lead(teleport(world(0, 30)) + speed("2"), event("e", action, after(1.0)))
    assert where(3.0)[0] == pytest.approx(6.0) and said == [f"s/a/e/e action: {sentence} is not understood"]


def test_what_an_entity_is_cannot_be_left_out() -> None:
    with pytest.raises(
        ScenarioError, match="by_hand.xosc: EntityRef: entityRef: the expression '.who' .* is not understood"
    ):
        read(written(entity("lead"), "", group("$who", event("e", speed("2")))))
    with pytest.raises(ScenarioError, match="by_hand.xosc: entityRef: there is no entity 'nobody'"):
        read(written(entity("lead"), start("nobody", speed("2"))))


def test_whatever_is_not_read_is_listed() -> None:
    """Attributes and elements that nobody knows, by their element; the same ones once, with their number."""
    line = polyline((0.0, world(0)), (1.0, world(10))).replace("<Vertex", '<Vertex wobble="3"')
    action = follow(line, "position", timing(), 'flies="true"').replace("<Shape>", "<Wings/><Shape>")
    _, said = lead(
        teleport(world(0)), event("e", action), head='<RoadNetwork><LogicFile filepath="a.xodr"/></RoadNetwork>'
    )
    assert said == [
        "RoadNetwork: not read: LogicFile",
        "FollowTrajectoryAction: not read: flies='true'",
        "Trajectory: not read: Wings",
        "Vertex: not read: wobble='3' (2 times)",
    ]


def test_entities_are_mapped_to_actors() -> None:
    text = written(entity("Cut") + entity("Ego"), start("Cut", teleport(world(3))) + start("Ego", teleport(world(5))))
    edits, said = read(text, Cut="other")
    assert at(edits["other"][0])(0.0)[0] == 3.0 and said == []
    _, said = read(text)
    assert said == ["entity 'Cut': the log has no such actor: it is left out (--map 'Cut=ACTOR' gives one)"]
    assert set(read(text, Cut="ego", Ego="lead")[0]) == {"ego", "lead", "other"}
    _, said = read(text.replace('"Cut"', '"hero"'))
    assert said == ["entity 'Ego': the log has no such actor: it is left out (--map 'Ego=ACTOR' gives one)"]
    for wrong, sentence in (
        ({"Cat": "lead"}, r"--map Cat=lead: there is no entity 'Cat' \(there are Cut, Ego\)"),
        ({"Cut": "led"}, r"--map Cut=led: no actor 'led' in the log \(there are ego, lead, other\)"),
        ({"Cut": "ego"}, "the entities 'Cut' and 'Ego' are both ego of the log"),
    ):
        with pytest.raises(ScenarioError, match=sentence):
            read(text, Path("by_hand.xosc"), **wrong)


def test_who_stands_where_it_was_recorded_to_start_stands() -> None:
    """The recording moves on from there."""
    edits, said = read(
        written(
            entity("Ego") + entity("lead"),
            start("Ego", teleport(world(0)), speed("0")) + start("lead", teleport(world(40)), speed("0")),
        )
    )
    for name, x in (("ego", 0.0), ("lead", 40.0)):
        (edit,) = edits[name]
        assert at(edit)(0.0)[0] == at(edit)(4.0)[0] == pytest.approx(x, abs=1e-6)
    assert said == []


def test_an_edit_between_recorded_places_is_one() -> None:
    """Both of its vertices lie where the recording is at their times, and its heading alone differs between."""
    line = polyline((0.0, world(40)), (2.0, world(46, 0)), (4.0, world(60)))
    where, _ = lead("", event("e", follow(line, "position", timing())))
    assert where(2.0)[0] == pytest.approx(46.0)


def test_an_action_that_is_refused_as_it_starts_changes_nothing() -> None:
    """ "lead" goes on as it was recorded, whether the place that is not known stands first or last."""
    lost, there = lane(5, road=7), world(50)
    for own, masters in ((lost, there), (there, lost)):
        action = f"""<SynchronizeAction masterEntityRef="Ego"><TargetPositionMaster>{masters}</TargetPositionMaster>
<TargetPosition>{own}</TargetPosition></SynchronizeAction>"""
        edits, said = read(
            written(entity("Ego") + entity("lead"), "", group("lead", event("e", private(action), after(0.5))))
        )
        assert "lead" not in edits and any("is not understood" in one for one in said), (edits, said)


def test_a_place_beside_another_one_without_distances_is_at_it() -> None:
    beside = '<RelativeObjectPosition entityRef="other" dx="2"/>'
    edits, said = read(written(entity("lead") + entity("other"), start("lead", teleport(beside), speed("1"))))
    assert at(edits["lead"][0])(0.0)[:2] == pytest.approx((2.0, 3.5))
    assert said == ["Init: lead: RelativeObjectPosition without dy: it is taken as 0"] or any(
        "without dy: it is taken as 0" in one for one in said
    )


def test_headings_of_an_untimed_trajectory_that_are_not_stated_are_said() -> None:
    line = polyline((None, world(0, 0, "")), (None, world(20, 0, "")))
    _, said = lead(teleport(world(0)) + speed("5"), event("e", follow(line, "position")))
    assert any("without h has the heading 0" in one for one in said)
    _, said = lead(teleport(world(0)) + speed("5"), event("e", follow(line, "follow")))
    assert not any("without h has the heading 0" in one for one in said)


@pytest.mark.parametrize("mode", ["follow", "position"])
def test_who_is_backing_as_its_trajectory_begins_drives_along_it_in_reverse(mode: str) -> None:
    """From its first place to its last one, its rear ahead, and straight on in reverse from there."""
    line = polyline((None, world(20)), (None, world(10)), (None, world(10, 8)))
    where, said = lead(teleport(world(20)) + speed("-5"), event("e", follow(line, mode)))
    back = {"follow": (0.0, -90.0), "position": (180.0, 180.0)}[mode]
    for time, place in ((0.0, (20, 0)), (1.0, (15, 0)), (3.0, (10, 5)), (4.0, (10, 10))):
        x, y, heading = where(time)
        assert (x, y) == pytest.approx(place, abs=0.1)
        assert math.remainder(heading - back[time > 2], 360) == pytest.approx(0.0, abs=0.1)
    assert "entity 'lead': its speed is negative as its trajectory begins: it drives along it in reverse" in said


def test_a_trajectory_driven_in_reverse_ends_at_its_last_place() -> None:
    line = polyline((None, world(20)), (None, world(10)))
    state = """<ByValueCondition><StoryboardElementStateCondition storyboardElementType="event" storyboardElementRef="e"
state="completeState"/></ByValueCondition>"""
    events = event("e", follow(line)) + event("stop", speed("0"), condition(state))
    for skipped, ends in ((0, 10.0), (4, 10.0)):
        offset = events.replace(
            "<FollowTrajectoryAction ", f'<FollowTrajectoryAction initialDistanceOffset="{skipped}" '
        )
        where, _ = lead(teleport(world(20)) + speed("-5"), offset)
        assert where(0.0)[0] == 20.0 - skipped and where(4.0)[0] == pytest.approx(ends, abs=0.15)


def test_a_speed_on_a_trajectory_that_becomes_negative_is_said() -> None:
    line = polyline((None, world(20)), (None, world(0)))
    where, said = lead(teleport(world(20)) + speed("4"), event("e", follow(line)) + event("v", speed("-1"), after(1.0)))
    assert any("its speed on a trajectory becomes negative" in one for one in said)
    assert where(3.0)[0] == pytest.approx(18.0, abs=0.1)


def test_who_drives_does_not_stand_for_no_time() -> None:
    stands = of_entity("lead", '<StandStillCondition duration="0"/>', edge="rising")
    events = event("brake", speed("0"), after(1.0)) + event("go", speed("3"), stands)
    where, _ = lead(teleport(world(0)) + speed("10"), events)
    assert where(1.0)[0] == pytest.approx(10.0, abs=0.3) and where(3.0)[0] == pytest.approx(16.0, abs=0.3)


def test_an_event_is_executed_once_an_edge() -> None:
    quicker = '<RelativeTargetSpeed entityRef="lead" value="2" speedTargetValueType="delta" continuous="false"/>'
    rising = condition(
        '<ByValueCondition><SimulationTimeCondition value="1" rule="greaterThan"/></ByValueCondition>', edge="rising"
    )
    again = event("e", speed(quicker), rising).replace("priority=", 'maximumExecutionCount="3" priority=')
    where, _ = lead(teleport(world(0)) + speed("5"), again)
    assert where(3.0)[0] - where(2.0)[0] == pytest.approx(7.0, abs=1e-3)


def test_a_box_of_another_height_stands_on_the_same_ground() -> None:
    """ "lead" is 1.5 m high in the log."""
    for height in (1.0, 1.5, 2.5):
        box = (
            entity("lead")
            .replace('z="0"/><Dimensions', f'z="{height / 2}"/><Dimensions')
            .replace('height="1.5"', f'height="{height}"')
        )
        assert box != entity("lead")
        edits, _ = read(written(box, start("lead", teleport(world(20)))))
        (edit,) = edits["lead"]
        assert isinstance(edit, Move) and edit.pose is not None
        assert edit.pose.position[2] == pytest.approx(0.75)


@pytest.mark.parametrize(
    "beside",
    [
        '<RelativeRoadPosition entityRef="Ego" ds="30" dt="3"><Orientation h="{h}"/></RelativeRoadPosition>',
        '<RelativeLanePosition entityRef="Ego" dLane="0" ds="30" offset="3"><Orientation h="{h}"/></RelativeLanePosition>',
    ],
)
@pytest.mark.parametrize(("h", "ahead"), [(0.0, 1), (math.pi, -1), (-3.0, -1)])
def test_who_is_turned_round_on_a_path_drives_it_the_other_way(beside: str, h: float, ahead: int) -> None:
    """Forward, as it is headed, not in reverse."""
    init = start("lead", teleport(beside.format(h=h)), speed("5"))
    edits, _ = read(written(entity("Ego") + entity("lead"), init))
    where = at(edits["lead"][0])
    assert where(0.0)[:2] == pytest.approx((30.0, 3.0), abs=1e-3)
    assert where(2.0)[:2] == pytest.approx((30.0 + ahead * 10, 3.0), abs=1.6)
    assert math.cos(math.radians(where(1.0)[2])) * ahead > 0.9


@pytest.mark.parametrize(("x", "past"), [(10, True), (60, False)])
def test_who_is_past_where_it_is_to_arrive_is_said(x: float, past: bool) -> None:
    action = f"""<SynchronizeAction masterEntityRef="Ego"><TargetPositionMaster>{world(80)}</TargetPositionMaster>
<TargetPosition>{world(x)}</TargetPosition></SynchronizeAction>"""
    _, said = read(written(entity("Ego") + entity("lead"), "", group("lead", event("e", private(action)))))
    assert any("'lead' is past its TargetPosition: it ends at once" in one for one in said) == past
