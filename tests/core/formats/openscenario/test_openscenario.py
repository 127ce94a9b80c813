"""Scenarios as OpenSCENARIO 1.3, valid for ASAM's own checker, and trajectories and events of such files back as edits."""

from __future__ import annotations

import json
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_log import write_small_log

pytest.importorskip("scenariogeneration")
from unisim_blender.core.cli.main import run  # noqa: E402
from unisim_blender.core.convert import read_scenario  # noqa: E402
from unisim_blender.core.prepare.scenario import prepare_scenario  # noqa: E402
from unisim_blender.core.scenario import load_scenario, plain  # noqa: E402
from unisim_blender.core.world.drive import Drive  # noqa: E402

EDITS = [
    {"type": "ego", "shift_left_m": 0.8},
    {"type": "move", "actor": "van", "pose": {"position": [9.0, -3.0, 1.1], "yaw_deg": 20}},
    {
        "type": "duplicate",
        "actor": "car-1",
        "id": "second",
        "offset_m": [-7, 0.5, 0],
        "present": {"start_s": 0.1, "end_s": 0.2},
    },
    {"type": "remove", "actor": "cone"},
]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("openscenario") / "bend"
    write_small_log(folder)
    return folder


@pytest.fixture(scope="module")
def scenario(log: Path) -> Path:
    document = {"format": "unisim-scenario", "version": 1, "name": "a bend, edited", "log": log.name, "edits": EDITS}
    path = log.parent / "edited.json"
    path.write_text(json.dumps(document))
    return path


@pytest.fixture(scope="module")
def written(scenario: Path) -> Path:
    out = scenario.parent / "written"
    assert run(["convert", str(scenario), "--to", "openscenario", "--out", str(out)]) == 0
    return out / "a_bend__edited.xosc"


def drive_of(path: Path) -> Drive:
    return prepare_scenario(path).edited


def test_asams_checker_finds_no_fault(written: Path, tmp_path: Path) -> None:
    pytest.importorskip("qc_openscenario")
    result = tmp_path / "result.xqar"
    configuration = f"""<?xml version="1.0"?>
<Config>
  <Param name="InputFile" value="{written}"/>
  <CheckerBundle application="xoscBundle"><Param name="resultFile" value="{result}"/></CheckerBundle>
</Config>"""
    (tmp_path / "config.xml").write_text(configuration)
    command = [sys.executable, "-m", "qc_openscenario.main", "-c", str(tmp_path / "config.xml")]
    subprocess.run(command, check=True, capture_output=True, cwd=tmp_path)
    checkers = list(ElementTree.parse(result).getroot().iter("Checker"))
    statuses = {one.get("checkerId"): one.get("status") for one in checkers}
    assert statuses["check_asam_xosc_xml_valid_schema"] == "completed" and len(statuses) > 10
    assert set(statuses.values()) <= {"completed", "skipped"}
    assert [issue.get("description") for one in checkers for issue in one.iter("Issue")] == []


def test_there_and_back(written: Path, scenario: Path, log: Path, tmp_path: Path) -> None:
    """Read over the log, the file gives the same drive; over its own scenario, it changes nothing."""
    assert ElementTree.parse(written).getroot().find("FileHeader").get("revMinor") == "3"  # type: ignore[union-attr]
    assert read(written, scenario, tmp_path / "same")[0].edits == load_scenario(scenario).edits
    found, losses = read(written, log, tmp_path / "back")
    assert losses == [
        "entity 'second': the log has no such actor: it is left out (--map 'second=ACTOR' gives one)",
        "Vehicle: not read: vehicleCategory='car' (4 times), Performance (4 times), Axles (4 times)",
    ]
    assert {edit.type for edit in found.edits} == {"ego", "move", "remove"}
    first, back = drive_of(scenario), drive_of(tmp_path / "back" / "scenario.json")
    times = np.linspace(0.0, max(first.time_s.values()), 13)
    for mine, its in (
        (first.world_from_ego, back.world_from_ego),
        (first.actors["van"].world_from_actor, back.actors["van"].world_from_actor),
        (first.actors["car-1"].world_from_actor, back.actors["car-1"].world_from_actor),
    ):
        assert np.abs(mine.at(times) - its.at(times)).max() < 1e-3
    assert back.actors.keys() == {"van", "car-1"}


def read(file: Path, base: Path, out: Path) -> tuple[Any, list[str]]:
    """The scenario of a file, and what of it is not understood."""
    done = read_scenario(file, base, out)
    return load_scenario(done.file), list(done.losses)


def file_of(folder: Path, entities: str, init: str, events: str = "") -> Path:
    """A file by hand, as another program may write it."""
    path = folder / "by_hand.xosc"
    path.write_text(f"""<?xml version="1.0"?>
<OpenSCENARIO>
  <FileHeader revMajor="1" revMinor="0" date="2026-01-01T00:00:00" description="by hand" author="hand"/>
  <ParameterDeclarations><ParameterDeclaration name="speed" parameterType="double" value="5.0"/></ParameterDeclarations>
  <CatalogLocations/><RoadNetwork/>
  <Entities>{entities}</Entities>
  <Storyboard>
    <Init><Actions>{init}</Actions></Init>
    <Story name="s"><Act name="a"><ManeuverGroup name="g" maximumExecutionCount="1">
      <Actors selectTriggeringEntities="false"><EntityRef entityRef="car-1"/></Actors>
      <Maneuver name="m">{events}</Maneuver>
    </ManeuverGroup><StartTrigger/></Act></Story>
  </Storyboard>
</OpenSCENARIO>""")
    return path


def entity(name: str) -> str:
    return f"""<ScenarioObject name="{name}"><Vehicle name="{name}" vehicleCategory="car"><BoundingBox>
<Center x="1.0" y="0" z="0.8"/><Dimensions width="2" length="4" height="1.6"/></BoundingBox></Vehicle></ScenarioObject>"""


def speed(value: str, shape: str = "step", dimension: str = "time", change: float = 0.0) -> str:
    return f"""<PrivateAction><LongitudinalAction><SpeedAction>
<SpeedActionDynamics dynamicsShape="{shape}" dynamicsDimension="{dimension}" value="{change}"/>
<SpeedActionTarget><AbsoluteTargetSpeed value="{value}"/></SpeedActionTarget></SpeedAction></LongitudinalAction>
</PrivateAction>"""


def event(name: str, action: str, condition: str) -> str:
    return f"""<Event name="{name}" priority="overwrite"><Action name="x">{action}</Action><StartTrigger><ConditionGroup>
<Condition name="c" delay="0" conditionEdge="none">{condition}</Condition></ConditionGroup></StartTrigger></Event>"""


AFTER = """<ByValueCondition><SimulationTimeCondition value="0.1" rule="greaterThan"/></ByValueCondition>"""
NEAR = """<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any"/><EntityCondition>
<EndOfRoadCondition duration="1"/></EntityCondition></ByEntityCondition>"""
CHANGE = """<PrivateAction><AppearanceAction><AnimationAction/></AppearanceAction></PrivateAction>"""


BOX = "entity 'car-1': its box of 4 x 2 x 1.6 m is not read: car-1 keeps its own of 4.5 x 1.9 x 1.6 m"
CATEGORY = "Vehicle: not read: vehicleCategory='car'"


def test_speeds_drive_along_the_recorded_path(log: Path, tmp_path: Path) -> None:
    """5 m/s by a parameter, and from 0.1 s on braking by 10 m/s²: 5 t, then less 5 (t - 0.1)²."""
    init = f"""<Private entityRef="car-1">{speed("$speed")}</Private>"""
    file = file_of(tmp_path, entity("car-1"), init, event("brakes", speed("0", "linear", "rate", 10.0), AFTER))
    found, losses = read(file, log, tmp_path / "out")
    assert losses == [BOX, CATEGORY] and [plain(edit)["type"] for edit in found.edits] == ["move", "remove", "remove"]
    back = drive_of(tmp_path / "out" / "scenario.json")
    car, recorded = back.actors["car-1"].world_from_actor, drive_of(log).actors["car-1"].world_from_actor
    went = np.linalg.norm(car.at(0.3)[:3, 3] - car.at(0.0)[:3, 3])
    assert went == pytest.approx(5 * 0.3 - 5 * 0.2**2, abs=0.06)  # its box's middle is in front
    places = recorded.at(np.linspace(-0.1, 0.4, 100))[:, :2, 3]
    assert np.hypot(*(places - car.at(0.3)[:2, 3]).T).min() < 0.1


def test_what_is_not_understood_is_listed(log: Path, tmp_path: Path) -> None:
    init = """<GlobalAction><EnvironmentAction/></GlobalAction><Private entityRef="car-1"><PrivateAction><TeleportAction>
<Position><GeoPosition latitudeDeg="1" longitudeDeg="1"/></Position></TeleportAction></PrivateAction></Private>"""
    events = event("changes", CHANGE, AFTER) + event("brakes", speed("0"), NEAR)
    _, losses = read(file_of(tmp_path, entity("car-1") + entity("stranger"), init, events), log, tmp_path / "out")
    assert losses == [
        "Init: EnvironmentAction is not understood",
        "Init: car-1: GeoPosition is not understood",
        "s/a/changes/x: AnimationAction is not understood",
        "s/a/brakes: StartTrigger: EndOfRoadCondition is not understood: its group of conditions is never met",
        "entity 'car-1': its place at the start is not known: it starts where it was recorded",
        BOX,
        "entity 'stranger': the log has no such actor: it is left out (--map 'stranger=ACTOR' gives one)",
        f"{CATEGORY} (2 times)",
    ]


def test_a_file_over_a_log(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What goes on after the log's end is cut there, an entity is an actor by its map, and the scenario opens."""
    follow = """<PrivateAction><RoutingAction><FollowTrajectoryAction><TrajectoryRef><Trajectory name="t" closed="false"><Shape>
<Polyline><Vertex time="0"><Position><WorldPosition x="0" y="0"/></Position></Vertex><Vertex time="5"><Position><WorldPosition
x="0" y="50"/></Position></Vertex></Polyline></Shape></Trajectory></TrajectoryRef><TimeReference><Timing offset="0" scale="1"
domainAbsoluteRelative="relative"/></TimeReference><TrajectoryFollowingMode followingMode="follow"/></FollowTrajectoryAction>
</RoutingAction></PrivateAction>"""
    teleport = "<PrivateAction><TeleportAction><Position>{}</Position></TeleportAction></PrivateAction>"
    beside = '<RelativeObjectPosition entityRef="cutter" dx="0" dy="9"/>'
    init = f"""<Private entityRef="hero">{teleport.format(beside)}</Private><Private entityRef="cutter">
{teleport.format('<WorldPosition x="7" y="0"/>')}</Private>"""
    events = event("drives", follow, AFTER).replace('priority="overwrite"', 'priority="override"')
    file = file_of(tmp_path, entity("cutter") + entity("hero"), init, events)
    file.write_text(file.read_text().replace('entityRef="car-1"', 'entityRef="cutter"'))
    out = tmp_path / "out"
    command = ["convert", str(file), "--from", "openscenario", "--log", str(log), "--out", str(out)]
    assert run([*command, "--map", "cutter=van"]) == 0
    said = capsys.readouterr().err
    assert "entity 'cutter': its trajectory goes on until 5.1 s: it is cut at the log's end, 0.327 s" in said
    drive = drive_of(out / "scenario.json")
    van, ego = drive.actors["van"].world_from_actor, drive.world_from_ego
    assert van.at(0.05)[0, 3] == pytest.approx(8.0)  # its box's middle is 1 m ahead
    assert van.at(0.327)[1, 3] == pytest.approx(10 * 0.227 + 1, abs=0.01)
    assert van.at(0.327)[0, 0] == pytest.approx(0.0, abs=1e-6)
    assert ego.at(0.2)[:3, 3] == pytest.approx([7.0, 9.0, 0.0]) and drive.actors.keys() == {"van"}
    for wrong, sentence in (("cutter", "must be ENTITY=ACTOR"), ("cutter=bus", "no actor 'bus' in the log")):
        assert run([*command[:-1], str(tmp_path / "again"), "--map", wrong]) == 1
        assert sentence in capsys.readouterr().err and not (tmp_path / "again").exists()
    assert run([*command[:-1], str(tmp_path / "again"), "--map", "cutter=van", "--map", "cutter=cone"]) == 1
    assert "cutter is mapped twice" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("not XML", "is no XML: "),
        ("<a/>", "is no OpenSCENARIO: its root is 'a'"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><OpenSCENARIO/>', "has a DOCTYPE or entities of its own, which are not read"),
        ('<OpenSCENARIO><FileHeader revMajor="2"/></OpenSCENARIO>', "FileHeader: revMajor must be 1"),
        ('<OpenSCENARIO><FileHeader revMajor="1"/></OpenSCENARIO>', "has no Storyboard"),
        (
            '<OpenSCENARIO><FileHeader revMajor="1"/><Catalog name="a"/></OpenSCENARIO>',
            "has no Storyboard: it is a Catalog, which goes with a scenario",
        ),
    ],
)
def test_refused(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str, sentence: str) -> None:
    file, out = tmp_path / "bad.xosc", tmp_path / "out"
    file.write_text(content)
    assert run(["convert", str(file), "--from", "openscenario", "--log", str(log), "--out", str(out)]) == 1
    assert f"{file}: {sentence}" in capsys.readouterr().err
    assert sorted(one.name for one in tmp_path.iterdir()) == ["bad.xosc"]


def test_a_number_that_is_none(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = file_of(tmp_path, entity("car-1"), f"""<Private entityRef="car-1">{speed("fast")}</Private>""")
    assert run(["convert", str(file), "--from", "openscenario", "--log", str(log), "--out", str(tmp_path / "out")]) == 1
    assert "AbsoluteTargetSpeed: value must be a finite number, not 'fast'" in capsys.readouterr().err


def test_options_that_do_not_go_together(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["--out", str(tmp_path / "out")]
    for more, sentence in (
        ([], "give --to or --from"),
        (["--to", "kitti", "--from", "openscenario"], "give --to or --from"),
        (["--from", "openscenario"], "--from and --log go together"),
        (["--to", "kitti", "--map", "a=b"], "--map needs --from"),
        (["--to", "moon"], "--to moon: must be one of argoverse2, kitti-object"),
    ):
        assert run(["convert", str(log), *more, *out]) == 1
        assert sentence in capsys.readouterr().err
