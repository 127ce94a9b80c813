"""Kinds of streets: a night with lamps, a curve, and a crossing with cars that turn."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from unisim_blender.core.cli.main import unisim
from unisim_blender.core.errors import LogError
from unisim_blender.core.evaluation.autonomy.document import bev_iou
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import FloatArray, Trajectory
from unisim_blender.core.world.drive import Actor
from unisim_street.layout import EGO_Y_M, StreetKind
from unisim_street.paint.light import lamp_light
from unisim_street.street import Recipe, Street, build_street, load_street
from unisim_street.truth import lamplight, make_world, trace_view, truth_camera
from unisim_street.usual_edits import usual_edits

KINDS: tuple[StreetKind, ...] = ("night", "curve", "crossing")


def _footprint(actor: Actor, time_s: float) -> FloatArray:
    pose = actor.world_from_actor.at(time_s)
    return np.array([*pose[:2, 3], *actor.size_m[:2], np.arctan2(pose[1, 0], pose[0, 0])])


@pytest.mark.parametrize("frames", [20, 80, 160])
@pytest.mark.parametrize("seed", [0, 1, 5])
@pytest.mark.parametrize("kind", ["straight", *KINDS])
def test_nothing_drives_through_anything(kind: StreetKind, seed: int, frames: int) -> None:
    drive = build_street(seed, frames, 32, 18, kind=kind).drive
    for frame in drive.frames[:: 4 if frames < 100 else 8]:
        time_s = drive.time_s[frame]
        there = [actor for actor in drive.actors.values() if actor.start_s <= time_s <= actor.end_s]
        ego = drive.world_from_ego.at(time_s)
        own = np.array([*(ego @ [1.4, 0.0, 0.0, 1.0])[:2], 4.8, 1.9, np.arctan2(ego[1, 0], ego[0, 0])])
        boxes = np.stack([own, *(_footprint(actor, time_s) for actor in there)])
        overlap = bev_iou(boxes, boxes) - np.eye(len(boxes))
        assert overlap.max() < 1e-9, (frame, [there[i - 1].uid if i else "ego" for i in np.argwhere(overlap > 0)[0]])


@pytest.mark.parametrize("seed", [0, 1])
def test_a_curve_is_driven_in_its_lane_to_either_side(seed: int) -> None:
    street = build_street(seed, 80, 32, 18, kind="curve")
    at = street.drive.world_from_ego.positions + street.drive.world_origin
    along, beside = street.plan.course.coordinates(at[:, :2])
    assert np.abs(beside - EGO_Y_M).max() < 0.17 and np.all(np.diff(along) > 0.7)
    forward = street.drive.world_from_ego.at(float(street.drive.world_from_ego.times_s[-1]))[:2, 0]
    turned = np.arctan2(forward[1], forward[0])
    assert np.sign(turned) == (-1) ** seed and abs(turned) > np.radians(45)
    assert not street.ground_height(at[:, :2]).any()
    # cars parked on the left stand on the left of the course
    places = street.drive.actors[usual_edits(street)["removal"][0]["actor"]].world_from_actor.positions
    assert 4 < street.plan.course.coordinates((places + street.drive.world_origin)[:, :2])[1][0] < 5.2


def _turn(keys: Trajectory) -> float:
    heading = np.unwrap(np.arctan2(keys.poses[:, 1, 0], keys.poses[:, 0, 0]))
    return float(np.degrees(np.ptp(heading)))


def test_cars_turn_at_a_crossing() -> None:
    drive = build_street(0, 80, 32, 18, kind="crossing").drive
    turns = sorted(_turn(actor.world_from_actor) for actor in drive.actors.values() if actor.is_moving)
    assert sum(turn > 80 for turn in turns) == 3
    straight = build_street(0, 80, 32, 18).drive
    assert max(_turn(actor.world_from_actor) for actor in straight.actors.values() if actor.is_moving) < 5
    low, high = build_street(0, 80, 32, 18, kind="crossing").plan.crossing
    end = float(drive.world_from_ego.positions[-1, 0])
    assert end - 15 < low < high < end + 25  # the drive's end lies about the crossing


def test_inserted_cars_keep_clear_of_the_crossing() -> None:
    for seed, kind in itertools.product(range(6), KINDS):
        street = build_street(seed, 20, 32, 18, kind=kind)
        position = np.array(usual_edits(street)["insertion"][0]["pose"]["position"]) + street.drive.world_origin
        along, beside = street.plan.course.coordinates(position[None, :2])
        assert 4.5 < beside[0] < 4.7
        assert not street.plan.crossing[0] - 4 < along[0] < street.plan.crossing[1] + 4


def _lit(street: Street) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Lamplight by `lamplight`, the same with nothing in between, and heights of the surfaces of an image."""
    world = make_world(street, street.drive)
    camera = street.drive.cameras["front_camera"]
    view = trace_view(world, camera, camera.time_s[3], 1, (0, camera.model.height), painted=False)
    seen = view.surfaces
    open_light = sum(lamp_light(lamp, seen.points, seen.soft_normals)[0] for lamp in world.light.lamps)
    return lamplight(world, seen, view.bundles.time_s.reshape(-1)), np.asarray(open_light), seen.points[:, 2]


def test_lamps_light_a_night_and_cast_shadows() -> None:
    street, day = (build_street(2, 6, 96, 54, kind=kind) for kind in ("night", "straight"))
    light, open_light, height = _lit(street)
    assert np.all(light <= open_light + 1e-9) and 0.03 < np.mean(
        light[open_light > 0.05] < 0.5 * open_light[open_light > 0.05]
    )
    assert np.median(light[height < 0.2]) > 0.1
    assert not make_world(day, day.drive).light.lamps.size and not _lit(day)[0].any()
    dark, bright = (truth_camera(s, s.drive, "front_camera", 3).rgb for s in (street, day))
    assert dark[:10].mean() < 0.35 * bright[:10].mean() and dark.mean() < 0.6 * bright.mean()
    # below a lamp it is brighter than between two, as by hand: cosine over distance squared
    lamp = street.light.lamps[0]
    points = lamp - [[0, 0, 5.15], [8.0, 0, 5.15]]
    below, beside = lamp_light(lamp, points, np.array([[0, 0, 1.0]] * 2))[0]
    assert below == pytest.approx(45 / 5**2 * (1 - (5 / 20) ** 4) ** 2)
    assert beside < below / 4


def test_a_kind_is_in_the_recipe_and_checked(tmp_path: Path) -> None:
    arguments = [
        "synth",
        str(tmp_path / "log"),
        "--kind",
        "crossing",
        "--frames",
        "2",
        "--width",
        "32",
        "--height",
        "18",
    ]
    result = CliRunner().invoke(unisim, [*arguments, "--quiet", "--jobs", "1", "--edits"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    street = load_street(tmp_path / "log")
    assert street.recipe.kind == "crossing" and street.drive.name == "crossing-0"
    assert set(open_log(tmp_path / "log").drive.actors) <= set(street.drive.actors)
    with pytest.raises(LogError, match="kind is one of straight, night, curve, crossing, not 'noon'"):
        Recipe(kind="noon")  # type: ignore[arg-type]
    with pytest.raises(LogError, match="not a curve"):
        Recipe(kind="curve", turns_deg=(90.0,), frames=400)
    with pytest.raises(LogError, match="a curve is drawn by the exact engine alone"):
        Recipe(kind="curve", engine="cycles")
