"""Rollouts from end to end on a small street: bytes, seeds, resuming, what drivers are told, and what is refused."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
import torch
from PIL import Image
from rendered_folder import captures
from written_street import write_street

from unisim_blender.core.cli.main import run
from unisim_blender.core.data.log import Sweep
from unisim_blender.core.errors import LogError, ScenarioError, SimulationError
from unisim_blender.core.export.film import CAPTION
from unisim_blender.core.formats.mcap.write import MCAP
from unisim_blender.core.formats.pandaset.read import ROAD, PandasetLog
from unisim_blender.core.prepare.scenario_plan import RenderOptions
from unisim_blender.core.scenario import load_scenario
from unisim_blender.core.scenario.simulation import OTHER_ACTORS, RateSpec, SimulationSpec
from unisim_blender.core.simulation.drivers import driver_named
from unisim_blender.core.simulation.drivers.driver import CheckedDriver, DriverSetup, EgoMotion, Observation
from unisim_blender.core.simulation.edits import edits_of
from unisim_blender.core.simulation.rollout import loop
from unisim_blender.core.simulation.rollout.run import complete
from unisim_blender.core.simulation.rollout.setup import open_scenario
from unisim_blender.core.simulation.rollout.steps import BASE_NAME, SCENARIO_NAME, STEPS_NAME, read_steps
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.simulation.step import step
from unisim_blender.core.simulation.vehicle.actions import Control
from unisim_blender.core.simulation.vehicle.parameters import Vehicle
from unisim_blender.core.simulation.world import recorded_keys

FRAMES = 8
SURFELS = ("--renderer", "surfel", "--quality", "fast")
DRIVERS = '''
"""A driver that brakes, and notes what it was told."""
import os
import pathlib
import time

import numpy as np
import torch
from unisim_blender.core.simulation.vehicle.actions import Control


class Braking:
    def __init__(self, setup):
        self.setup, self.seen = setup, []
        assert setup.recording is None

    def drive(self, seen):
        assert seen.traffic is None
        assert torch.get_num_threads() == 1  # as where sequences are rendered: its last bits depend on it
        for image in seen.images:
            assert image.rgb.dtype == np.uint8 and image.end_us <= seen.time_us
        for sweep in seen.sweeps:
            assert "instance" not in sweep.points.dtype.names and sweep.end_us <= seen.time_us
        self.seen.append(seen)
        return Control(-2.0, 0.02)

    def close(self):
        names = [[one.sensor_id for one in (*seen.images, *seen.sweeps)] for seen in self.seen]
        print(sorted(self.setup.sensors), names, len(self.setup.route) > 10)


class Waiting(Braking):
    """Thinks until the next image is there, or for too long."""

    def drive(self, seen):
        images = pathlib.Path(os.environ["WAITS_FOR"])
        before = len(list(images.glob("*.png")))
        assert before == len(self.seen)
        for _ in range(600 if len(self.seen) < 3 else 0):
            if len(list(images.glob("*.png"))) > before:
                break
            time.sleep(0.1)
        else:
            assert len(self.seen) >= 3, "nothing is rendered while the driver thinks"
        return super().drive(seen)


def fails(setup):
    driver = Braking(setup)
    asked = driver.drive

    def drive(seen):
        if seen.time_us >= 300_000:
            raise KeyboardInterrupt
        return asked(seen)

    driver.drive = drive
    return driver
'''


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_street(tmp_path_factory.mktemp("rollouts") / "street", FRAMES, columns=300)


@pytest.fixture(scope="module", autouse=True)
def drivers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drivers")
    (folder / "braking_drivers.py").write_text(DRIVERS)
    sys.path.append(str(folder))
    return folder


def drive(log: Path, out: Path, driver: str, *more: str, code: int = 0) -> Path:
    assert run(["drive", str(log), "--driver", driver, "--out", str(out), *SURFELS, *more]) == code
    return out


@pytest.fixture(scope="module")
def braking(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out, before = tmp_path_factory.mktemp("braking") / "out", torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        return drive(log, out, "braking_drivers:Braking", "--actors", "idm", "--film")
    finally:
        torch.set_num_threads(before)


def test_its_scenario_renders_to_the_drivers_bytes(braking: Path, tmp_path: Path) -> None:
    scenario = load_scenario(braking / SCENARIO_NAME)
    assert {edit.type for edit in scenario.edits} == {"ego", "move"}
    assert run(["render", str(braking / SCENARIO_NAME), "--out", str(tmp_path / "again"), "--jobs", "1", *SURFELS]) == 0
    told = captures(braking)
    assert len(told) > 15 and told == captures(tmp_path / "again")


def test_its_film_has_a_frame_a_step(braking: Path) -> None:
    reader = imageio_ffmpeg.read_frames(str(braking / "film.mp4"))
    about = next(reader)
    frames = [np.frombuffer(frame, np.uint8).reshape(*about["size"][::-1], 3).astype(int) for frame in reader]
    assert len(frames) == len(read_steps(braking)) and about["fps"] == pytest.approx(10)
    image = sorted((braking / "camera" / "front_camera").glob("*.png"))[-1]
    high = frames[0].shape[0] - CAPTION
    picture = Image.open(image).convert("RGB").resize((frames[0].shape[1] - high, high))
    shown = frames[-1][:high, : picture.width]
    assert np.abs(shown - np.asarray(picture)).mean() < 6 < np.abs(frames[0][:high, : picture.width] - shown).mean()
    above = frames[-1][:high, picture.width :]
    assert ((above[..., 0] > 180) & (above[..., 2] < 120) & (above[..., 1] > 90)).sum() > 10, "no ego vehicle"


def test_the_vehicle_left_its_log(log: Path, braking: Path, tmp_path: Path) -> None:
    """Else the test above would hold of a simulation in which nothing moves."""
    steps = read_steps(braking)
    assert steps[-1].ego.speed_m_s < steps[0].ego.speed_m_s - 1
    assert (
        run(["render", str(log), "--out", str(tmp_path / "log"), "--jobs", "1", "--times", "0.55:0.6:20", *SURFELS])
        == 0
    )
    name = "camera/front_camera/t0000000550000us.png"
    mine, theirs = (np.asarray(Image.open(folder / name)).astype(int) for folder in (braking, tmp_path / "log"))
    assert np.abs(mine - theirs).mean() > 1


def test_the_log_driver_is_the_replay(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rolled = drive(log, tmp_path / "rolled", "log", "--actors", "auto")
    assert "rendered anew" not in capsys.readouterr().err, "the replay is not what the driver saw"
    scenario = load_scenario(rolled / SCENARIO_NAME)
    assert scenario.edits == ()
    times = sorted({step for one in captures(rolled) if one.startswith("lidar") for step in [Path(one).stem]})
    first, last = (int(name[1:-2]) / 1e6 for name in (times[0], times[-1]))
    asked = ["--times", f"{first}:{last + 0.01}:10", "--sensors", "pandar64"]
    assert run(["render", str(log), "--out", str(tmp_path / "log"), "--jobs", "1", *asked, *SURFELS]) == 0
    told = {name: data for name, data in captures(rolled).items() if name.startswith("lidar") and name.endswith("npz")}
    replayed = captures(tmp_path / "log")
    assert len(told) >= FRAMES - 2 and all(replayed[name] == data for name, data in told.items())


def test_labels_say_where_the_road_is(log: Path, tmp_path: Path) -> None:
    """The street is labelled as road up to a place that the vehicle passes, and as sidewalk from there on."""

    class Labelled(PandasetLog):
        road = ROAD
        broken = False

        def sweep(self, lidar: str, frame: int) -> Sweep:
            if self.broken:
                raise LogError("the classes are broken")
            found = super().sweep(lidar, frame)
            return replace(found, semantic=np.where(found.points[:, 0] < 6.5, 7, 11).astype(np.int32))

    options = RenderOptions(renderer="surfel", quality="fast", sensors=("front_camera",), width=16)
    opened, asked = open_scenario(log, options), SimulationSpec(duration_s=0.5)
    labelled, folders = Labelled(log), [tmp_path / name for name in ("out", "refused")]
    for folder in folders:
        folder.mkdir()
    passing = replace(opened, log=labelled).simulation(asked, driver_named("constant"), folders[0])
    found = complete(passing, options).scores["off_road"]
    assert found["method"] == "road_labels" and found["off_road"] and 0.1 < found["first_s"] < 0.5
    labelled.broken = True
    refused = replace(opened, log=labelled).simulation(asked, driver_named("constant"), folders[1])
    with pytest.raises(LogError, match="the classes are broken"):
        complete(refused, options)
    assert read_steps(folders[1]) == [], "it drives before it tells what is wrong"


def test_another_drives_on_from_a_rollout(braking: Path, tmp_path: Path) -> None:
    """What ended before the start is the first rollout's to the bit, and the vehicle goes on from its state there."""
    start = 0.3
    more = ("--start", str(start), "--duration", "0.1", "--sensors", "front_camera")
    on = drive(braking / SCENARIO_NAME, tmp_path / "on", "constant", *more)
    first, then = (json.loads((folder / SCENARIO_NAME).read_text()) for folder in (braking, on))
    assert [edit["type"] for edit in then["edits"]].count("ego") == 1
    sensors = {
        kind: [{**one, "times": [time_s for time_s in one["times"] if time_s < start]} for one in listed]
        for kind, listed in first["sensors"].items()
    }
    (on / "past.json").write_text(json.dumps({**then, "sensors": sensors}))
    assert run(["render", str(on / "past.json"), "--out", str(tmp_path / "past"), "--jobs", "1", *SURFELS]) == 0
    told, again = captures(braking), captures(tmp_path / "past")
    before = [name for name in again if "labels" not in name]
    assert len(before) == 5 and all(told[name] == again[name] for name in before)
    states = {step.time_us: step.ego for step in read_steps(braking)}
    begun, last = read_steps(on)
    assert begun.time_us == 300_000 and begun.ego.speed_m_s == pytest.approx(states[300_000].speed_m_s, abs=0.1)
    assert (begun.ego.x_m, begun.ego.y_m) == pytest.approx((states[300_000].x_m, states[300_000].y_m), abs=1e-6)
    assert last.ego.speed_m_s > states[400_000].speed_m_s


def test_what_jumps_at_the_start_keeps_its_speed(log: Path, braking: Path, tmp_path: Path) -> None:
    """An actor and the vehicle are put ahead there: neither is faster for it."""
    document = json.loads((braking / SCENARIO_NAME).read_text())
    document["log"] = str(log)
    start, ahead = 0.3, 5.0
    for edit in document["edits"]:
        keys = edit["trajectory"]
        at = next(i for i, key in enumerate(keys) if abs(key["time_s"] - start) < 1e-9)
        later = [{**key, "position": [key["position"][0] + ahead, *key["position"][1:]]} for key in keys[at:]]
        edit["trajectory"] = [*keys[:at], {**keys[at], "time_s": start - 1e-6}, *later]
    (tmp_path / "jump.json").write_text(json.dumps(document))
    more = ("--start", str(start), "--duration", "0.1", "--sensors", "front_camera")
    rolled = [
        read_steps(drive(path, tmp_path / name, "constant", *more))
        for name, path in (("straight", braking / SCENARIO_NAME), ("jumped", tmp_path / "jump.json"))
    ]
    straight, jumped = (one[0] for one in rolled)
    assert jumped.ego.x_m == pytest.approx(straight.ego.x_m + ahead, abs=1e-6)
    assert jumped.ego.speed_m_s == pytest.approx(straight.ego.speed_m_s, abs=0.2)
    moving = [uid for uid, one in straight.actors.items() if one["speed_m_s"] > 1]
    assert moving
    for uid in moving:
        assert jumped.actors[uid]["speed_m_s"] == pytest.approx(straight.actors[uid]["speed_m_s"], abs=0.3), uid
        for a, b in ((rolled[1][1], jumped), (rolled[0][1], straight)):
            gone = a.actors[uid]["position_m"][0] - b.actors[uid]["position_m"][0]
            assert abs(gone) < 0.1 * 20, uid


def test_the_same_seed_is_the_same_bytes(log: Path, tmp_path: Path) -> None:
    scenario = tmp_path / "random.json"
    document = {
        "format": "unisim-scenario", "version": 1, "name": "random", "log": str(log), "edits": [],
        "simulation": {"jitter": {"ego_aside_m": 0.5, "ego_speed_m_s": 1.0, "actors_s": 0.3}, "duration_s": 0.3},
    }  # fmt: skip
    scenario.write_text(json.dumps(document))
    one, same, other = (
        drive(scenario, tmp_path / name, "constant", "--seed", seed, "--actors", "auto", "--sensors", "front_camera")
        for name, seed in (("one", "1"), ("same", "1"), ("other", "2"))
    )
    assert captures(one) == captures(same)
    assert (one / STEPS_NAME).read_bytes() == (same / STEPS_NAME).read_bytes()
    assert captures(one) != captures(other)
    begun = [read_steps(folder)[0].ego for folder in (one, other)]
    assert begun[0].y_m != begun[1].y_m and begun[0].speed_m_s != begun[1].speed_m_s


def test_a_rollout_is_resumed(log: Path, braking: Path, tmp_path: Path) -> None:
    more = ("--actors", "idm")
    out = drive(log, tmp_path / "out", "braking_drivers:fails", *more, code=130)
    assert 2 <= len(read_steps(out)) < len(read_steps(braking))
    with (out / STEPS_NAME).open("a") as file:
        file.write('{"time_us": 4')  # as a machine that lost its power leaves it
    rendered = {path: path.stat().st_mtime_ns for path in (out / "camera").rglob("*.png")}
    drive(log, out, "braking_drivers:Braking", *more, "--resume")
    assert captures(out) == captures(braking)
    assert (out / STEPS_NAME).read_bytes() == (braking / STEPS_NAME).read_bytes()
    assert rendered and all(path.stat().st_mtime_ns == time for path, time in rendered.items())


def test_what_a_driver_is_told(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive(log, tmp_path / "out", "braking_drivers:Braking", "--duration", "0.3")
    told = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("['front"))
    # the first sweep ends some microseconds after 0.1 s: it comes a step later
    assert told == "['front_camera', 'pandar64'] [[], ['front_camera'], ['front_camera', 'pandar64']] True"


def test_rates_of_sensors_that_are_left_out(log: Path, tmp_path: Path) -> None:
    """They do not hinder; those of a sensor that there is not are refused."""
    rates = {name: RateSpec(0.2) for name in ("front_camera", "pandar64")}
    opened = open_scenario(log, RenderOptions(renderer="surfel", sensors=("front_camera",)))
    simulation = opened.simulation(SimulationSpec(rates=rates), driver_named("constant"), tmp_path)
    assert simulation.spec.rates == {"front_camera": RateSpec(0.2)}
    times = [one.capture.time_us for one in simulation.context.exposures]
    assert len(times) > 2 and set(np.diff(times)) == {200_000}
    with pytest.raises(ScenarioError, match="simulation.rates.rear: is not one of front_camera"):
        opened.simulation(SimulationSpec(rates={"rear": RateSpec(0.2)}), driver_named("constant"), tmp_path)


def test_an_answer_takes_effect_after_its_delay(log: Path, tmp_path: Path) -> None:
    late = drive(
        log,
        tmp_path / "late",
        "braking_drivers:Braking",
        "--delay",
        "0.2",
        "--duration",
        "0.5",
        "--sensors",
        "front_camera",
    )
    speeds = [step.ego.speed_m_s for step in read_steps(late)]
    assert speeds[0] == speeds[1] == speeds[2] > speeds[3] > speeds[4]


def test_sensors_are_rendered_while_the_driver_thinks(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The driver waits for an image that ends after its answer is due, and so would wait for ever."""
    monkeypatch.setenv("WAITS_FOR", str(tmp_path / "out" / "camera" / "front_camera"))
    more = ("--delay", "0.1", "--duration", "0.4", "--sensors", "front_camera")
    out = drive(log, tmp_path / "out", "braking_drivers:Waiting", *more)
    assert [step.ego.speed_m_s for step in read_steps(out)][2:] < [step.ego.speed_m_s for step in read_steps(out)][1:]
    assert run(["render", str(out / SCENARIO_NAME), "--out", str(tmp_path / "again"), "--jobs", "1", *SURFELS]) == 0
    assert captures(out) == captures(tmp_path / "again")


def test_many_rollouts_are_the_same_in_one_process_and_in_three(log: Path, tmp_path: Path) -> None:
    scenario = tmp_path / "random.json"
    document = {
        "format": "unisim-scenario", "version": 1, "name": "random", "log": str(log), "edits": [],
        "simulation": {"jitter": {"ego_aside_m": 0.5, "actors_s": 0.3}, "duration_s": 0.2},
    }  # fmt: skip
    scenario.write_text(json.dumps(document))
    more = ("--seed", "4", "--rollouts", "3", "--sensors", "front_camera", "--width", "64", "--format", "mcap")
    one = drive(scenario, tmp_path / "one", "constant", *more)
    three = drive(scenario, tmp_path / "three", "constant", *more, "--jobs", "3")
    names = ["seed-4", "seed-5", "seed-6"]
    assert sorted(path.name for path in one.iterdir()) == names
    for name in names:
        assert captures(one / name) == captures(three / name) and len(captures(one / name)) >= 2
        for file in (STEPS_NAME, SCENARIO_NAME, "scores.json", MCAP.output):
            assert (one / name / file).read_bytes() == (three / name / file).read_bytes()
    assert captures(one / "seed-4") != captures(one / "seed-5")


def test_many_rollouts_are_refused_in_a_format_that_lacks_files(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "labels.json"
    document = {"format": "unisim-scenario", "version": 1, "name": "labels", "log": str(log), "edits": []}
    scenario.write_text(json.dumps({**document, "outputs": {"formats": ["labels"]}}))
    drive(scenario, tmp_path / "out", "constant", "--rollouts", "2", "--format", "mcap", code=1)
    assert f"{scenario}: the format mcap is made of png files" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("actors", ["absent", "continue", "hold"])
def test_on_after_the_recording(log: Path, tmp_path: Path, actors: str) -> None:
    """It lasts 0.7 s. What is rendered of the scenario has the driver's bytes there, too."""
    scenario = tmp_path / "longer.json"
    document = {
        "format": "unisim-scenario", "version": 1, "name": "longer", "log": str(log), "edits": [],
        "outside": {"actors": actors, "ego": "hold"}, "simulation": {"start_s": 0.5, "duration_s": 0.6},
    }  # fmt: skip
    scenario.write_text(json.dumps(document))
    out = drive(scenario, tmp_path / "out", "braking_drivers:Braking", "--actors", "auto")
    last = read_steps(out)[-1]
    assert last.time_us == 1_100_000 and any("t0000001" in one for step in read_steps(out) for one in step.captures)
    assert run(["render", str(out / SCENARIO_NAME), "--out", str(tmp_path / "again"), "--jobs", "1", *SURFELS]) == 0
    told = captures(out)
    assert len(told) > 10 and told == captures(tmp_path / "again")
    drive(scenario, tmp_path / "log", "log", code=1)


def test_the_drive_of_a_world_is_that_of_its_edits(log: Path, tmp_path: Path) -> None:
    asked = SimulationSpec(actors={OTHER_ACTORS: {"type": "auto"}})
    simulation = open_scenario(log, RenderOptions(renderer="surfel")).simulation(
        asked, driver_named("constant"), tmp_path
    )
    world, context, moved = simulation.begin, simulation.context, simulation.scenario_drive
    while world.time_us < context.stop_us:
        world = step(world, Control(-2.0, 0.05), context)
        wanted = moved.with_edits(edits_of(moved, world.ego_keys, world.keys, world.strayed, world.vanished_s))
        found = moved.drive_at(world)
        assert found.actors.keys() == wanted.actors.keys()
        for uid, actor in found.actors.items():
            other = wanted.actors[uid]
            assert (actor.start_s, actor.end_s, actor.is_moving) == (other.start_s, other.end_s, other.is_moving)
            if not actor.is_ego_body:
                assert actor.world_from_actor.content() == other.world_from_actor.content()
        for name, camera in found.cameras.items():
            at = np.linspace(world.time_us - 90_000, world.time_us, 7) / 1e6
            other_camera = wanted.cameras[name].world_from_camera
            np.testing.assert_allclose(camera.world_from_camera.at(at), other_camera.at(at), atol=1e-5)
    assert world.strayed


def test_the_lengths_of_actors_paths_are_those_of_the_scenario_of_what_was_driven(log: Path, tmp_path: Path) -> None:
    """By which people's legs move: a world has the keys of the last second alone."""
    (tmp_path / "longer.json").write_text(json.dumps({
        "format": "unisim-scenario", "version": 1, "name": "longer", "log": str(log), "edits": [],
        "outside": "continue", "simulation": {"start_s": 0.5, "duration_s": 2.3, "actors": {OTHER_ACTORS: {"type": "auto"}}},
    }))  # fmt: skip
    opened = open_scenario(tmp_path / "longer.json", RenderOptions(renderer="surfel", sensors=("front_camera",)))
    assert opened.scenario.simulation is not None
    simulation = opened.simulation(opened.scenario.simulation, driver_named("constant"), tmp_path)
    world, context, moved = simulation.begin, simulation.context, simulation.scenario_drive
    history = loop._History()
    history.note(world)
    while world.time_us < context.stop_us:
        world = step(world, Control(0.5, 0.03), context)
        history.note(world)
    drive, at = moved.drive_at(world), np.linspace(world.time_us - 90_000, world.time_us, 7) / 1e6
    lengths = []
    for uid, known in history.actors.items():
        keys = known.keys()
        keys = (*recorded_keys(moved.base.actors[uid].world_from_actor, None, keys[0].time_s), *keys)
        (edit,) = edits_of(moved, (), {uid: keys}, world.strayed, world.vanished_s)
        whole = moved.with_edits([edit]).actors[uid].world_from_actor
        own = drive.actors[uid].world_from_actor
        assert len(own.times_s) < len(whole.times_s)
        np.testing.assert_allclose(own.walked_at(at), whole.walked_at(at), atol=1e-9)
        lengths.append(own.start_walked_m)
    assert max(lengths) > 1.0


def test_cameras_have_the_scenarios_poses_long_after_the_recording(log: Path, tmp_path: Path) -> None:
    """It ends at 0.7 s; where a sensor is on the vehicle does not change from 1.7 s on. To the bit, or bytes would differ."""
    (tmp_path / "longer.json").write_text(json.dumps({
        "format": "unisim-scenario", "version": 1, "name": "longer", "log": str(log), "edits": [],
        "outside": "continue", "simulation": {"start_s": 0.5, "duration_s": 2.3},
    }))  # fmt: skip
    opened = open_scenario(tmp_path / "longer.json", RenderOptions(renderer="surfel", sensors=("front_camera",)))
    simulation = opened.simulation(SimulationSpec(), driver_named("constant"), tmp_path)
    world, context, moved = simulation.begin, simulation.context, simulation.scenario_drive
    keys, seen = {key.time_s: key for key in world.ego_keys}, []
    while world.time_us < context.stop_us:
        before, world = world, step(world, Control(0.5, 0.03), context)
        keys |= {key.time_s: key for key in world.ego_keys}
        drive = moved.drive_at(world)
        for one in context.ended(before.time_us, world.time_us):
            times = np.linspace(one.start_us, one.end_us, 4) / 1e6
            seen.append((times, drive.cameras["front_camera"].world_from_camera.at(times)))
    whole = moved.with_edits(edits_of(moved, tuple(keys[at] for at in sorted(keys)), {}, frozenset(), {}))
    assert seen[-1][0][0] > 2.5
    for times, poses in seen:
        np.testing.assert_array_equal(poses, whole.cameras["front_camera"].world_from_camera.at(times))


def test_a_sensor_may_deliver_nothing(log: Path, tmp_path: Path) -> None:
    """A rollout that is shorter than a sweep has an image, and its scenario says that the LiDAR captures never."""
    out = drive(log, tmp_path / "out", "constant", "--duration", "0.06", "--width", "32")
    sensors = load_scenario(out / SCENARIO_NAME).sensors
    assert sensors is not None and [one.times for one in sensors.lidars or ()] == [()]
    assert len([*out.glob("camera/*/*.png")]) == 1 and not [*out.glob("lidar/*/*.npz")]


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (("--driver", "nobody"), '--driver "nobody": must be one of log, constant, idm, egodriver, or module:function'),
        (("--driver", "no_module:f"), '--driver "no_module:f": Python finds no module'),
        (("--driver", "braking_drivers:np"), "must be a function of a DriverSetup"),
        (("--duration", "9"), "simulation: 0 to 9 s must lie within the recording, 0 … 0.7 s"),
        (
            ("--duration", "0.01"),
            "simulation: from 0 to 0.01 s no exposure of front_camera, pandar64 is complete: the first",
        ),
        (("--duration", "nan"), "simulation.duration_s: nan is not a finite number"),
        (("--start", "0.7"), "simulation.start_s: 0.7 s must lie within the recording, 0 … 0.7 s, and before its end"),
        (("--step", "0"), "simulation.step_s: 0.0 is less than the minimum of 0.01"),
        (("--actors", "fly"), "simulation.actors.*.type: must be one of"),
        (("--delay", "0.15"), "0.15 s must be a multiple of the step, 0.1 s"),
        (("--sensors", "rear"), 'sensor "rear": is not one of front_camera, pandar64'),
    ],
)
def test_refused(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: tuple[str, ...], sentence: str
) -> None:
    asked = ["drive", str(log), "--out", str(tmp_path / "out"), *SURFELS]
    asked += [*more] if more[0] == "--driver" else ["--driver", "log", *more]
    assert run(asked) == 1
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "out" / SCENARIO_NAME).exists()


def test_another_rollout_is_not_continued(log: Path, braking: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (braking / BASE_NAME).read_bytes()
    drive(log, braking, "braking_drivers:Braking", "--seed", "9", "--resume", code=1)
    assert "is the rollout of another scenario or of other options" in capsys.readouterr().err
    drive(log, braking, "braking_drivers:Braking", code=1)
    assert "is not empty" in capsys.readouterr().err
    assert (braking / BASE_NAME).read_bytes() == before


WRONG = '''
"""Drivers that do what none may."""
import numpy as np
from unisim_blender.core.simulation.vehicle.actions import Control, Plan

ANSWERS = {
    "Nothing": lambda seen: None,
    "Pair": lambda seen: (0.5, 0.01),
    "Numbers": lambda seen: np.zeros(2, np.float32),
    "Generator": lambda seen: (Control(one, 0.0) for one in range(3)),
    "NotFinite": lambda seen: Control(float("nan"), 0.0),
    "PlanNotFinite": lambda seen: Plan([seen.time_us + 1], [np.nan], [0.0], [0.0]),
    "PlanShape": lambda seen: Plan([seen.time_us + 1], np.zeros(2), [0.0], [0.0]),
    "Raises": lambda seen: {}["here"],
    "Leaves": lambda seen: exit("gone"),
}


class Wrong:
    answer = ""

    def __init__(self, setup):
        self.count = 0

    def drive(self, seen):
        self.count += 1
        return Control(0.0, 0.0) if self.count < 3 else ANSWERS[self.answer](seen)

    def close(self):
        pass


for name in ANSWERS:
    globals()[name] = type(name, (Wrong,), {"answer": name})


class Unmade(Wrong):
    def __init__(self, setup):
        raise RuntimeError("no weights")


def nothing(setup):
    return None


class Endless:
    def __init__(self, setup):
        pass

    def drive(self, seen):
        return Control(0.0, 0.0)


class Unclosed(Endless):
    def close(self):
        raise OSError("still open")
'''


@pytest.mark.parametrize(
    ("driver", "sentence"),
    [
        ("Nothing", "at step 3, 0.2 s: answered with None, not with a Control or a Plan; the steps before it are kept"),
        ("Pair", "answered with a tuple (0.5, 0.01), not with a Control or a Plan"),
        ("Numbers", "answered with a ndarray of shape (2,) array([0., 0.], dtype=float32), not"),
        ("Generator", "answered with a generator <generator object"),
        ("NotFinite", "0.2 s: control: acceleration_m_s2 must be a finite number, not nan (wrong_drivers.py, line 11)"),
        ("PlanNotFinite", "plan: x_m of pose 0 must be a finite number, not nan (wrong_drivers.py, line 12)"),
        ("PlanShape", "plan: x_m must be 1 numbers, as many as times_us, not of shape (2,) (wrong_drivers.py, line 13)"),
        ("Raises", "at step 3, 0.2 s: KeyError: 'here' (wrong_drivers.py, line 14), traceback in "),
        ("Leaves", "at step 3, 0.2 s: SystemExit: gone (wrong_drivers.py, line 15), traceback in "),
        ("Unmade", "at its start: RuntimeError: no weights (wrong_drivers.py, line 39), traceback in "),
        ("nothing", "must give an object with drive(observation) and close(); None has no drive"),
        ("Endless", "must give an object with drive(observation) and close(); a Endless <"),
    ],
)  # fmt: skip
def test_a_drivers_wrong_answer(drivers: Path, tmp_path: Path, driver: str, sentence: str) -> None:
    (drivers / "wrong_drivers.py").write_text(WRONG)
    kind, told = driver_named(f"wrong_drivers:{driver}"), ""
    motion = (EgoMotion(0, EgoState(0.0, 0.0, 0.0, 5.0)),)
    try:
        checked = CheckedDriver.started(kind, DriverSetup(Vehicle(), {}, np.zeros((2, 2)), 100_000, 0, 0), tmp_path)
        for step in range(3):
            checked.drive(Observation(step * 100_000, (), (), motion))
    except SimulationError as error:
        told = str(error)
    assert told.startswith(f'driver "wrong_drivers:{driver}"') and sentence in told and "\n" not in told
    kept = tmp_path / "driver-error.txt"
    assert kept.exists() == ("traceback in" in sentence)
    if kept.exists():
        assert f"traceback in {kept}" in told and "wrong_drivers.py" in kept.read_text()
        assert str(Path(loop.__file__).parents[3]) not in kept.read_text(), "of the driver's code alone"


def test_a_rollout_goes_on_once_its_driver_is_mended(
    log: Path, drivers: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And a driver that cannot be closed has driven all the same."""
    (drivers / "wrong_drivers.py").write_text(WRONG)
    more = ("--sensors", "front_camera", "--width", "32", "--duration", "0.4")
    out = drive(log, tmp_path / "out", "wrong_drivers:Raises", *more, code=1)
    told = capsys.readouterr().err.splitlines()[-1]
    assert told.startswith('Error: driver "wrong_drivers:Raises" at step 3, 0.2 s: KeyError: ')
    assert len(read_steps(out)) == 3 and (out / "driver-error.txt").exists(), "the start, and two steps"
    with pytest.warns(UserWarning, match='driver "wrong_drivers:Unclosed" as it was closed: OSError: still open'):
        drive(log, out, "wrong_drivers:Unclosed", *more, "--resume")
    assert (out / SCENARIO_NAME).exists() and len(read_steps(out)) == 5


def test_a_driver_of_the_working_directory(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [one for one in sys.path if one])
    (tmp_path / "nearby.py").write_text("def straight(setup):\n    return None\n\nlimit = 3\n")
    (tmp_path / "needs.py").write_text("import no_such_package\n")
    (tmp_path / "broken.py").write_text("\n\ndef f(:\n")
    (tmp_path / "fails_at_import.py").write_text("x = 1\n\nraise ValueError('no\\nweights')\n")
    assert driver_named("nearby:straight").name == "nearby:straight"
    for name, sentence in {
        "absent:f": "Python finds no module 'absent', neither in " + str(tmp_path),
        "nearby.py:straight": "write nearby:straight",
        "nearby:Straight": f"{tmp_path / 'nearby.py'} has no 'Straight'; it has straight",
        "nearby:limit": "limit must be a function of a DriverSetup, not a int",
        "needs:f": "needs imports a module that is absent: no_such_package",
        "broken:f": "cannot be imported: SyntaxError: invalid syntax",
        "fails_at_import:f": f"cannot be imported: {tmp_path / 'fails_at_import.py'}, line 3: ValueError: no weights",
    }.items():
        assert run(["drive", str(log), "--driver", name, "--out", str(tmp_path / "out")]) == 1
        told = capsys.readouterr().err
        assert f'Error: --driver "{name}": ' in told and sentence in told and "Traceback" not in told
    assert not (tmp_path / "out").exists()
