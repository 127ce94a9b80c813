"""Simulating from Blender: settings that a scenario states, rollouts in the background, opened, and driven on from."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from concurrent.futures import wait
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest
from click.testing import CliRunner
from helpers import SAMPLE, driving, imported, read, select

from unisim_blender.bridge.changes.variants import variants_of
from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.views import rollouts as views
from unisim_blender.core.cli.main import unisim
from unisim_blender.core.scenario import apply_scenario, load_scenario
from unisim_blender.core.scenario.edits import Insert
from unisim_blender.core.simulation.rollout.steps import read_steps
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.source import scene_actors
from unisim_blender.editing.simulation.rollouts import (
    COLUMNS,
    best_values,
    in_order,
    listed_rollouts,
    options_path,
    read_rollout,
    rollout_name,
    variant_of,
)
from unisim_blender.editing.simulation.stated import count_steps
from unisim_blender.features.drive.export_operators import scenario_of
from unisim_blender.features.drive.import_operators import UNISIM_OT_open_rollout
from unisim_blender.features.simulation import panel as simulation
from unisim_blender.features.simulation.operators import RolloutTask, UNISIM_OT_sort_rollouts, rollout_folders
from unisim_blender.features.simulation.overlay import lines_now
from unisim_blender.features.simulation.panel import rows_of
from unisim_blender.features.simulation.properties import driver_of
from unisim_blender.process import background
from unisim_blender.registering import classes_of

SIMULATION = {
    "start_s": 0.2, "duration_s": 0.5, "step_s": 0.1, "delay_s": 0.1, "seed": 7,
    "vehicle": {"length_m": 4.6}, "jitter": {"ego_speed_m_s": 0.5}, "rates": {"front_camera": {"period_s": 0.2}},
    "actors": {"*": {"type": "auto", "departure_m": 0.123456789}, "car-03": {"type": "scripted",
    "keys": [{"time_s": 0.0, "speed_m_s": 5.0}, {"time_s": 1.0, "left_m": 0.5}]}},
}  # fmt: skip


@pytest.fixture(autouse=True)
def one_task() -> Iterator[None]:
    """No task is left over."""
    yield
    background.running.clear()
    background.newest.clear()
    views.forget()


def stating(simulation: dict[str, Any] | None, path: Path) -> Path:
    """A scenario of the sample's street with a simulation."""
    document: dict[str, Any] = {
        "format": "unisim-scenario", "version": 1, "name": "simulated", "log": str(SAMPLE.parent / "out" / "street"),
        "scene": str(SAMPLE / "scene"), "edits": [], "outputs": {"quality": "fast"},
    }  # fmt: skip
    path.write_text(json.dumps(document if simulation is None else {**document, "simulation": simulation}))
    return path


@pytest.fixture(scope="module")
def rolled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a rollout: `idm`, which plans, and actors that follow; the vehicle starts faster than recorded."""
    folder = tmp_path_factory.mktemp("rolled")
    simulation = {"duration_s": 0.5, "seed": 2, "jitter": {"ego_speed_m_s": 4.0}, "actors": {"*": {"type": "idm"}}}
    path = stating(simulation, folder / "simulated.json")
    command = ["drive", str(path), "--driver", "idm", "--out", str(folder / "rollout")]
    result = CliRunner().invoke(unisim, [*command, "--sensors", "front_camera", "--width", "32"])
    assert result.exit_code == 0, result.output
    return folder / "rollout"


def opened(scene: Any, folder: Path) -> Any:
    """The scene of an opened rollout."""
    assert bpy.ops.unisim.open_rollout(directory=str(folder)) == {"FINISHED"}
    return bpy.context.scene


def export(path: Path) -> Any:
    """The scenario that the shown scene is written as."""
    assert bpy.ops.unisim.export_scenario(filepath=str(path)) == {"FINISHED"}
    return load_scenario(path)


@pytest.mark.parametrize("simulation", [SIMULATION, {"seed": 2**40}, {"duration_s": 0.1}, None])
def test_settings_come_back_as_they_were_stated(scene: Any, tmp_path: Path, simulation: dict[str, Any] | None) -> None:
    path = stating(simulation, tmp_path / "a.json")
    assert bpy.ops.unisim.import_scenario(filepath=str(path)) == {"FINISHED"}
    again = export(tmp_path / "b.json")
    assert again.simulation == load_scenario(path).simulation
    assert json.loads((tmp_path / "b.json").read_text()).get("simulation") == simulation


def test_settings_show_and_change_what_is_stated(scene: Any, tmp_path: Path) -> None:
    path = stating(SIMULATION, tmp_path / "a.json")
    assert bpy.ops.unisim.import_scenario(filepath=str(path)) == {"FINISHED"}
    about, car = scene.unisim_simulation, imported(scene, "ACTOR", "car-03")
    assert (about.starts, about.ends, about.seed) == (True, True, 7)
    assert about.start_s == pytest.approx(0.2) and about.duration_s == pytest.approx(0.5)
    assert about.others.kind_of_others == "auto" and car.unisim_model.kind == "scripted"
    assert car.unisim_model.keys == "0 5, 1 - 0.5" and about.others.departure_m == pytest.approx(0.123457, abs=1e-6)
    about.duration_s, about.step_s, about.seed = 0.7, 0.05, 8
    about.starts, about.others.headway_s = False, 2.5
    car.unisim_model.keys = "0 5, 0.5 0, 2 - -1.5"
    car.unisim_model.keys = "no keys"  # not taken over
    other = driving(scene, "Car")
    other.unisim_model.kind = "cut_in"
    other.unisim_model.duration_s = 2.0
    found = json.loads(export(tmp_path / "b.json").path.read_text())["simulation"]
    expected = {**SIMULATION, "duration_s": 0.7, "step_s": 0.05, "seed": 8}
    del expected["start_s"]
    expected["actors"] = {
        "*": {"type": "auto", "departure_m": 0.123456789, "headway_s": 2.5},
        "car-03": {"type": "scripted", "keys": [{"time_s": 0.0, "speed_m_s": 5.0}, {"time_s": 0.5, "speed_m_s": 0.0},
                   {"time_s": 2.0, "left_m": -1.5}]},
        other.unisim.uid: {"type": "cut_in", "duration_s": 2.0},
    }  # fmt: skip
    assert found == expected


def test_a_delay_stays_a_multiple_of_the_step(street: Any) -> None:
    about = street.unisim_simulation
    about.delay_s = 0.26
    assert about.delay_s == pytest.approx(0.3)
    about.step_s = 0.2
    assert about.delay_s == pytest.approx(0.2) or about.delay_s == pytest.approx(0.4)
    assert read(street).simulation is not None  # which checks it


def test_undo_takes_a_setting_back(street: Any) -> None:
    name = driving(street, "Car").name
    bpy.ops.ed.undo_push(message="before")
    street.unisim_simulation.seed = 5
    street.objects[name].unisim_model.kind = "attack"
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert scene.unisim_simulation.seed == 0 and scene.objects[name].unisim_model.document == ""
    bpy.ops.ed.redo()
    scene = bpy.context.scene
    assert scene.unisim_simulation.seed == 5 and scene.objects[name].unisim_model.kind == "attack"


def test_models_go_with_their_actors(street: Any, tmp_path: Path) -> None:
    """Into copies, by the copy's id; that of a removed actor is not in the scenario; a file keeps them."""
    car = driving(street, "Car")
    select(car)
    car.unisim_model.kind = "idm"
    uid = car.unisim.uid
    assert bpy.ops.unisim.duplicate_actor(where="LEFT") == {"FINISHED"}
    copy = bpy.context.active_object
    copy.unisim_model.gap_m = 3.0
    spec = read(street).simulation
    assert spec is not None and spec.actors is not None
    (new,) = set(spec.actors) - {uid}
    assert spec.actors == {uid: {"type": "idm"}, new: {"type": "idm", "gap_m": 3.0}}
    car.hide_render = True
    spec = read(street).simulation
    assert spec is not None and set(spec.actors or {}) == {new}
    select(copy, driving(street, "Car"))
    bpy.context.view_layer.objects.active = copy
    assert bpy.ops.unisim.same_model() == {"FINISHED"}
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    spec = read(bpy.context.scene).simulation
    assert spec is not None and (spec.actors or {})[new] == {"type": "idm", "gap_m": 3.0}
    assert bpy.ops.unisim.forget_model(name=copy_name(new)) == {"FINISHED"}
    spec = read(bpy.context.scene).simulation
    assert new not in ((spec.actors if spec else None) or {})


def copy_name(uid: str) -> str:
    """The name of a copy's object, which is its id."""
    return uid


def test_buttons_say_why_they_are_grey(street: Any, tmp_path: Path) -> None:
    about = street.unisim_simulation
    assert not bpy.ops.unisim.simulate.poll()  # the .blend was never saved
    about.out = str(tmp_path)
    assert bpy.ops.unisim.simulate.poll() and not bpy.ops.unisim.drive_on.poll()
    about.choice = "MODULE"
    assert not bpy.ops.unisim.simulate.poll() and driver_of(street) == ""
    about.function = "my.drivers:Mine"
    assert bpy.ops.unisim.simulate.poll() and driver_of(street) == "my.drivers:Mine"
    about.choice = "egodriver"
    assert driver_of(street) == ""
    about.address = "localhost:6789"
    assert driver_of(street) == "egodriver" and "address" in drawn_panels()
    about.choice = "idm"
    assert driver_of(street) == "idm"


def test_a_rollout_runs_and_is_resumed(street: Any, tmp_path: Path) -> None:
    about = street.unisim_simulation
    about.out, about.choice = str(tmp_path / "rollouts"), "constant"
    about.ends, about.duration_s = True, 0.2
    street.unisim.quality, street.unisim.sequence_sensors, street.unisim.sequence_width = "fast", "CAMERA", 32
    assert bpy.ops.unisim.simulate() == {"FINISHED"}
    folder = tmp_path / "rollouts" / "Scene constant 1"
    task = background.newest[RolloutTask]
    assert (task.folder, task.total, task.done, task.problem) == (folder, 2.0, 2.0, "")
    assert len(read_steps(folder)) == 3 and about.scored == str(folder)
    rows = rows_of(street, folder)
    assert rows is not None and ("Collisions", "0, at fault: 0", False) in rows
    images = {path: path.stat().st_mtime_ns for path in (folder / "camera").rglob("*.png")}
    (folder / "scores.json").unlink()
    assert rows_of(street, folder) is None
    assert bpy.ops.unisim.simulate() == {"FINISHED"}  # the same: resumed
    assert rows_of(street, folder) is not None
    assert images and all(path.stat().st_mtime_ns == time for path, time in images.items())
    about.choice, about.function = "MODULE", "no_such_module:Driver"
    with pytest.raises(RuntimeError, match="Python finds no module 'no_such_module'"):
        bpy.ops.unisim.simulate()


def test_a_rollout_opens_as_driven(scene: Any, rolled: Path, tmp_path: Path) -> None:
    shown = opened(scene, rolled)
    about, drive = shown.unisim_simulation, source_of(shown).drive
    assert shown == scene and about.rollout == str(rolled)
    assert tuple(about.span_s) == pytest.approx((0.0, 0.5)) and about.seed == 2
    states, ego = {step.time_us: step.ego for step in read_steps(rolled)}, imported(shown, "EGO", "ego")
    clock = Clock.of(drive)
    for frame in (2, 5):
        shown.frame_set(frame)
        state = states[round(1e6 * float(clock.time_s(np.array(float(frame)))))]
        place = ego.matrix_world.translation
        assert (place.x, place.y) == pytest.approx((state.x_m, state.y_m), abs=2e-3)
        assert abs(place.x - drive.world_from_ego.at(clock.time_s(np.array(float(frame))))[0, 3]) > 0.05


def test_an_opened_rollout_is_the_same_scenario_to_the_bit(scene: Any, rolled: Path, tmp_path: Path) -> None:
    shown = opened(scene, rolled)
    again, first = export(tmp_path / "again.json"), load_scenario(rolled / "scenario.json")
    drives = [apply_scenario(one, source_of(shown).drive, scene_actors) for one in (first, again)]
    trajectories = [
        {"ego": one.world_from_ego, **{uid: actor.world_from_actor for uid, actor in one.actors.items()},
         **{name: camera.world_from_camera for name, camera in one.cameras.items()}}
        for one in drives
    ]  # fmt: skip
    assert trajectories[0].keys() == trajectories[1].keys()
    for name, mine in trajectories[0].items():
        assert mine.content() == trajectories[1][name].content(), name
    assert again.simulation == first.simulation and again.sensors == first.sensors
    car = driving(shown, "Car")
    car.location.y += 1.0
    edits = {
        edit.type: edit for edit in export(tmp_path / "edited.json").edits if getattr(edit, "actor", "ego") == "ego"
    }
    assert "ego" in edits  # only the car is elsewhere
    moved = apply_scenario(load_scenario(tmp_path / "edited.json"), source_of(shown).drive, scene_actors)
    for name in ("ego", car.unisim.uid):
        after = moved.world_from_ego if name == "ego" else moved.actors[name].world_from_actor
        assert (after.content() == trajectories[0][name].content()) == (name == "ego")


def test_a_rollout_opens_beside_a_drive_as_a_variant(street: Any, rolled: Path) -> None:
    street.unisim_simulation.choice = "idm"
    shown = opened(street, rolled)
    assert shown != street and set(variants_of(street)) == {street, shown}
    assert shown.unisim_simulation.choice == "idm" and not street.unisim_simulation.rollout


@pytest.fixture
def rolled_with_new_actors(rolled: Path, tmp_path: Path) -> Path:
    """The folder of a rollout with a copy and with a car of another trained scene, whose folder its scenario names."""
    folder = tmp_path / "rollouts" / "rollout"
    shutil.copytree(rolled, folder)
    document = json.loads((folder / "scenario.json").read_text())
    pose = {"position": [30.0, 9.0, 0.8], "yaw_deg": 0.0}
    (tmp_path / "another").symlink_to(SAMPLE / "scene")
    document["log"], document["scene"] = str(SAMPLE.parent / "out" / "street"), str(SAMPLE / "scene")
    document["edits"] += [
        {"type": "duplicate", "actor": "car-03", "id": "Copy", "offset_m": [0, 3.5, 0]},
        {"type": "insert", "actor": "car-03", "scene": "../../another", "id": "New", "pose": pose},
    ]
    (folder / "scenario.json").write_text(json.dumps(document))
    return folder


def test_beside_a_drive_a_rollout_keeps_the_ids_of_new_actors(street: Any, rolled_with_new_actors: Path) -> None:
    for taken in ("Copy", "New"):
        street.collection.objects.link(bpy.data.objects.new(taken, None))
    shown = opened(street, rolled_with_new_actors)
    again = scenario_of(shown, rolled_with_new_actors / "again.json", start_s=0.3)
    drive = apply_scenario(again, source_of(shown).drive, scene_actors)
    assert {"Copy", "New"} <= set(drive.actors) and not any(uid.startswith(("Copy.", "New.")) for uid in drive.actors)


def test_driving_on_names_the_scene_of_an_actor_that_was_removed(scene: Any, rolled_with_new_actors: Path) -> None:
    shown = opened(scene, rolled_with_new_actors)
    bpy.data.objects.remove(shown.objects["New"])
    path = rolled_with_new_actors.parent / "on.json"  # in another folder
    again = scenario_of(shown, path, start_s=0.3)
    (edit,) = [edit for edit in again.edits if isinstance(edit, Insert)]
    assert again.resolve(str(edit.scene)) == (SAMPLE / "scene").resolve()
    new = apply_scenario(again, source_of(shown).drive, scene_actors).actors["New"]
    assert new.present(0.1) and not new.present(0.4)


def test_a_view_never_draws_a_rollout_with_another_engine(street: Any, rolled: Path) -> None:
    """Blender's own would compile its shaders, for ten seconds, before the scene has its drive."""
    street.render.engine = "UNISIM"
    steps = UNISIM_OT_open_rollout.work(steps_of(rolled), bpy.context)
    engines = {bpy.context.scene.render.engine for _ in steps}
    assert bpy.context.scene != street and engines == {"UNISIM"}


def steps_of(folder: Path) -> Any:
    """What the operator's steps need of it."""
    own = SimpleNamespace(filepath="", directory=str(folder), timer=None, report=lambda *_: None)
    for name in ("parts", "bring_in", "bring_in_edited"):
        setattr(own, name, getattr(UNISIM_OT_open_rollout, name).__get__(own))
    return own


def test_a_rollout_that_was_opened_is_shown_again_and_read_again_after_a_change(street: Any, rolled: Path) -> None:
    shown = opened(street, rolled)
    name, moved = shown.name, driving(shown, "Car").name
    shown.objects[moved].location.y += 1.0
    bpy.context.window.scene = street
    assert opened(street, rolled) == shown and shown.objects[moved].location.y == 1.0
    bpy.context.window.scene = street
    os.utime(rolled / "scores.json")
    again = opened(street, rolled)
    assert again.name == name and set(variants_of(street)) == {street, again}
    assert all(obj.location.y != 1.0 for obj in again.objects if obj.name.startswith(moved))


def test_rollouts_of_rollouts_are_named_alike(tmp_path: Path) -> None:
    folder = tmp_path / rollout_name("My scene", "package:Driver", 12)
    assert variant_of(folder) == folder.name == "My scene Driver 12"  # the command line's may be named so, too
    options_path(folder).touch()
    assert variant_of(folder) == "My scene"


def test_rollouts_are_listed_with_their_scores(street: Any, tmp_path: Path) -> None:
    street.unisim_simulation.out = str(tmp_path)
    assert not bpy.ops.unisim.compare_rollouts.poll()
    values = {"Scene idm 2": (0, 3.0), "Scene idm 10": (1, 0.5), "Scene log 1": None}
    for name, scores in values.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "steps.jsonl").write_text("{}\n" * 3)
        if scores is not None:
            document = {"driver": "idm", "duration_s": 4.0, "collision": {"count": scores[0], "first_s": 1.5 * scores[0] or None},
                        "time_to_collision": {"minimum_s": scores[1]}, "pdms": {"score": 0.5}}  # fmt: skip
            (tmp_path / name / "scores.json").write_text(json.dumps(document))
    rows = in_order(listed_rollouts(rollout_folders(street)), -1)
    assert [(row.folder.name, row.driver, row.end) for row in rows] == [
        ("Scene idm 2", "idm", "To its end: 4.0 s"),
        ("Scene idm 10", "idm", "Collision at 1.5 s"),
        ("Scene log 1", "", "Stopped after 2 steps"),
    ]
    assert best_values(rows)[:3] == ["0", "3.0 s", ""]  # PDMS is the same for both: none is the best
    ttc = [column.title for column in COLUMNS].index("Least TTC")
    assert [row.folder.name for row in in_order(rows[::-1], ttc)] == ["Scene idm 2", "Scene idm 10", "Scene log 1"]
    bpy.ops.unisim.hide_rollout(name="Scene idm 10")
    assert {folder.name for folder in rollout_folders(street)} == {"Scene idm 2", "Scene log 1"}
    bpy.ops.unisim.hide_rollout(name="")
    assert len(rollout_folders(street)) == 3


def test_every_column_is_a_score_that_is_written(rolled: Path) -> None:
    scores = json.loads((rolled / "scores.json").read_text())
    for number, column in enumerate(COLUMNS):
        assert column.key in scores[column.member], column.title
        explained = UNISIM_OT_sort_rollouts.description(bpy.context, SimpleNamespace(column=number))
        assert explained == column.about and "better" in explained


def test_collisions_and_ttc_are_markers(scene: Any, rolled: Path, tmp_path: Path) -> None:
    scores = json.loads((rolled / "scores.json").read_text())
    contact = {"actor": "car-03", "label": "Car", "time_s": 0.3, "at_start": False, "at_fault": True,
               "relative_speed_m_s": 4.0, "side": "front"}  # fmt: skip
    scores["collision"]["contacts"] = [contact, {**contact, "actor": "car-12", "at_start": True}]
    scores["time_to_collision"] |= {"minimum_s": 0.8, "minimum_at_s": 0.2, "actor": "car-03"}
    folder = tmp_path / "crashed"
    folder.mkdir()
    for path in rolled.glob("*.js*"):
        (folder / path.name).write_bytes(path.read_bytes())
    document = json.loads((folder / "scenario.json").read_text())
    for member in ("log", "scene"):
        document[member] = str((rolled / document[member]).resolve())
    (folder / "scenario.json").write_text(json.dumps(document))
    (folder / "scores.json").write_text(json.dumps(scores))
    shown = opened(scene, folder)
    name = imported(shown, "ACTOR", "car-03").name
    clock = Clock.of(source_of(shown).drive)
    frames = [round(float(clock.frame(np.array(time_s)))) for time_s in (0.2, 0.3)]
    found = sorted((marker.frame, marker.name) for marker in shown.timeline_markers)
    assert found == list(zip(frames, [f"UniSim TTC 0.8 s: {name}", f"UniSim Collision: {name}"], strict=True))


def test_plans_and_the_recorded_drive_are_drawn(scene: Any, rolled: Path) -> None:
    shown = opened(scene, rolled)
    about = shown.unisim_simulation
    shown.frame_set(4)
    both = lines_now(shown)
    about.show_plans = False
    ghost = lines_now(shown)
    about.show_plans, about.show_ghost = True, False
    plan = lines_now(shown)
    assert both is not None and ghost is not None and plan is not None
    assert len(plan.points) > 10 and len(ghost.points) > 24 and len(both.points) == len(plan.points) + len(ghost.points)
    ego = imported(shown, "EGO", "ego").matrix_world.translation
    assert np.linalg.norm(plan.points[:, :2] - np.array(ego)[:2], axis=1).min() < 3.0
    drive = source_of(shown).drive
    recorded = drive.world_from_ego.at(drive.time_s[4])[:2, 3]
    corners = ghost.points[24:48, :2]  # of the second box, after the driven one
    assert np.abs(corners.mean(0) - recorded)[1] < 1.0 and np.abs(corners.mean(0) - recorded)[0] < 3.0
    shown.frame_set(9)
    after = lines_now(shown)
    assert after is not None and not len(after.points)  # no plan after the end
    about.show_plans = False
    assert lines_now(shown) is None


def test_a_file_reads_its_rollout_again_in_a_thread(scene: Any, rolled: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = opened(scene, rolled)
    views.forget()
    go_on, reading = Event(), read_rollout
    monkeypatch.setattr(views, "read_rollout", lambda folder: (go_on.wait(10), reading(folder))[1])
    assert views.rollout_of(shown) is None and views.rollout_of(shown) is None
    go_on.set()
    assert not wait(views._read.values(), 10).not_done
    found = views.rollout_of(shown)
    assert found is not None and len(found.plans) == 5


def test_drive_on_from_a_frame(scene: Any, rolled: Path, tmp_path: Path) -> None:
    """As driven until then; the edit holds from then on, where the car jumps."""
    shown = opened(scene, rolled)
    about = shown.unisim_simulation
    about.out, about.choice = str(tmp_path), "constant"
    shown.unisim.sequence_width, shown.unisim.sequence_sensors = 32, "CAMERA"
    shown.frame_set(0)
    assert not bpy.ops.unisim.drive_on.poll()
    drive = source_of(shown).drive
    shown.frame_set(3)
    start_s = 0.3
    assert bpy.ops.unisim.drive_on.poll() and drive.time_s[3] == pytest.approx(start_s)
    car = driving(shown, "Car")
    car.location.y += 2.0
    gone = next(obj for obj in shown.objects if obj.unisim.kind == "ACTOR" and obj != car and not obj.hide_render
                and drive.actors[obj.unisim.uid].is_moving)  # fmt: skip
    gone.hide_render = True
    gone_uid, car_uid = gone.unisim.uid, car.unisim.uid
    assert bpy.ops.unisim.drive_on() == {"FINISHED"}
    assert about.start_s == pytest.approx(start_s) and about.duration_s == pytest.approx(0.2)
    folder = Path(about.scored)
    first = apply_scenario(load_scenario(rolled / "scenario.json"), drive, scene_actors)
    then = apply_scenario(load_scenario(folder / "scenario.json"), drive, scene_actors)
    for name in ("ego", *first.actors):
        one, other = (d.world_from_ego if name == "ego" else d.actors[name].world_from_actor for d in (first, then))
        if len(one.times_s) == 1:
            continue
        before = one.times_s < start_s - 1e-4
        assert before.sum() > 2 and (other.times_s[: before.sum()] == one.times_s[before]).all(), name
        assert (other.positions[: before.sum()] == one.positions[before]).all(), name
    a, b = (d.actors[car_uid].world_from_actor for d in (first, then))
    assert np.linalg.norm(b.at(start_s)[:3, 3] - a.at(start_s)[:3, 3]) == pytest.approx(2.0, abs=0.01)
    assert np.linalg.norm(b.at(start_s - 1e-3)[:3, 3] - a.at(start_s - 1e-3)[:3, 3]) < 0.02
    assert then.actors[gone_uid].present(0.1) and not then.actors[gone_uid].present(0.45)
    steps = read_steps(folder)
    assert steps[0].time_us == 300_000 and steps[-1].time_us == 500_000
    assert steps[0].actors[car_uid]["speed_m_s"] < 30  # it is not faster for its jump
    states = {step.time_us: step.ego for step in read_steps(rolled)}
    assert steps[0].ego.speed_m_s == pytest.approx(states[300_000].speed_m_s, abs=0.2)
    assert opened(shown, folder) != shown


def test_what_is_no_rollout_is_refused(street: Any, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="holds no finished rollout"):
        bpy.ops.unisim.open_rollout(directory=str(tmp_path))
    (tmp_path / "steps.jsonl").write_text("{}\n")
    stating(None, tmp_path / "scenario.json")
    scenes = len(bpy.data.scenes)
    with pytest.raises(RuntimeError, match="line 1 is no step of a rollout"):
        bpy.ops.unisim.open_rollout(directory=str(tmp_path))
    assert len(bpy.data.scenes) == scenes and bpy.context.scene == street


def test_steps_are_counted_as_they_are_made(street: Any) -> None:
    scenario = read(street)
    drive = source_of(street).drive
    span = max(drive.time_s.values()) - min(drive.time_s.values())
    assert count_steps(scenario, drive) == round(span / 0.1)
    street.unisim_simulation.starts, street.unisim_simulation.start_s = True, 0.5
    assert count_steps(read(street), drive) == round(span / 0.1) - 5


class Noted:
    """A layout that notes what is drawn in place of drawing it: settings by their names, buttons by theirs, and texts."""

    def __init__(self, into: list[str]) -> None:
        self.into = into

    def __getattr__(self, kind: str) -> Any:
        def drawn(*given: Any, **more: Any) -> Any:
            if kind == "prop":
                assert given[1] in given[0].bl_rna.properties
                self.into.append(given[1])
            elif kind == "operator":
                self.into.append(given[0])
                return SimpleNamespace()
            elif more.get("text"):
                self.into.append(more["text"])
            return Noted(self.into)

        return drawn


def drawn_panels() -> list[str]:
    """What the panel Simulate and the panels in it show."""
    found: list[str] = []
    for panel in classes_of(simulation):
        panel.draw(SimpleNamespace(layout=Noted(found)), bpy.context)
    return found


def test_the_panel_shows_settings_parameters_and_scores(street: Any, rolled: Path) -> None:
    select(driving(street, "Car"))
    street.unisim_simulation.others.kind_of_others = "cut_in"
    found = drawn_panels()
    assert {"seed", "quality", "out", "cut_in_gap_m", "unisim.simulate", "No rollout yet"} <= set(found)
    assert "keys" not in found
    bpy.context.active_object.unisim_model.kind = "scripted"
    about = street.unisim_simulation
    about.choice, about.document, about.scored = "MODULE", '{"rates": {}}', str(rolled)
    found = drawn_panels()
    assert {
        "function",
        "keys",
        "unisim.forget_model",
        "Kept as imported: rates",
        "jitter_yaw",
        "Collisions",
        "Least TTC",
    } <= set(found)
    about.scored = str(rolled.parent / "nowhere")
    assert "Not scored yet" in drawn_panels()
