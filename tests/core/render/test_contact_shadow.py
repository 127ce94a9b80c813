"""Soft shadows: dark under the body, nothing far away, nothing on actors, nothing for actors that are not there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tiny_drive import tiny_drive

from unisim_blender.core.geometry import FloatArray, Trajectory
from unisim_blender.core.render.captures import states_of
from unisim_blender.core.render.contact_shadow import FADE_M, MAX_DARKENING, SHADOW_CUTOFF_M, displaced, faded, shaded
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.scenes.recipe import load_backend
from unisim_blender.core.scenes.scene import open_scene
from unisim_blender.core.sensors.frames import CameraFrame
from unisim_blender.core.world.drive import Actor, Drive
from unisim_blender.core.world.replay import WorldState

CAR = replace(
    tiny_drive().actors["car"],
    world_from_actor=Trajectory(
        np.zeros(1), np.array([[0.0, 0.0, 0.75]]), np.array([[np.cos(0.3), 0, 0, np.sin(0.3)]])
    ),
)
X, Y = np.meshgrid(np.linspace(-8, 8, 65), np.linspace(-8, 8, 65))
GROUND = np.stack([X, Y, np.zeros_like(X)], -1)
GREY = np.full((65, 65, 3), 0.5, np.float32)
EVERYWHERE = np.ones((65, 65), bool)


def test_dark_under_the_body_and_nothing_far_away() -> None:
    out = shaded(GREY, GROUND, EVERYWHERE, [CAR], 0.0)
    linear = (out[32, 32, 0] + 0.055) / 1.055
    lit = ((0.5 + 0.055) / 1.055) ** 2.4
    assert abs(linear**2.4 / lit - (1 - MAX_DARKENING)) < 0.01
    far = np.hypot(X, Y) > np.hypot(*CAR.size_m[:2]) / 2 + SHADOW_CUTOFF_M
    assert np.abs(out[far] - 0.5).max() < 0.003
    # it follows the turned body: further along it than across it
    ahead, left = np.array([np.cos(0.6), np.sin(0.6)]), np.array([-np.sin(0.6), np.cos(0.6)])

    def at(place: FloatArray) -> float:
        i, j = np.unravel_index(np.hypot(X - place[0], Y - place[1]).argmin(), X.shape)
        return float(out[i, j, 0])

    assert at(1.8 * ahead) < at(1.8 * left) - 0.05


def test_actors_and_what_is_absent_are_left_alone() -> None:
    ground = EVERYWHERE.copy()
    ground[30:35, 30:35] = False
    out = shaded(GREY, GROUND, ground, [CAR], 0.0)
    assert (out[30:35, 30:35] == 0.5).all()
    assert shaded(GREY, GROUND, EVERYWHERE, [replace(CAR, start_s=1.0)], 0.0) is GREY
    assert shaded(GREY, GROUND, EVERYWHERE, [], 0.0) is GREY


def test_the_ground_of_a_displaced_actor_fades_towards_the_sides_of_its_box() -> None:
    length, width, height = CAR.size_m
    local = np.array([
        [0, 0, 0],  # the middle of the ground
        [0, width / 2, 0],
        [length / 2 - FADE_M / 2, 0, 0],
        [0, width / 2, 0.3],  # a wheel's side
        [0, width / 2, height - 0.1],  # the roof
    ])  # fmt: skip
    pose = CAR.world_from_actor.at(0.0)
    points = local @ pose[:3, :3].T + [5.0, 3.0, 0.1]  # where it is now, the road is lower
    moved = replace(CAR, world_from_actor=CAR.world_from_actor.transformed(pose_at(5.0, 3.0, 0.1)))
    owner = np.ones(5, np.int32)

    def heights(places: FloatArray) -> FloatArray:
        return places[:, 2]

    share = faded(points, np.zeros(5), owner, {1: moved}, {CAR.uid: CAR}, heights)
    np.testing.assert_allclose(share, [0, 1, 0.5, 0, 0], atol=1e-6)
    assert not faded(points, np.zeros(5), 0 * owner, {1: moved}, {CAR.uid: CAR}, heights).any()
    ego = Trajectory(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]))
    recorded = {CAR.uid: CAR}
    for actor, expected in ((CAR, []), (moved, [moved]), (replace(CAR, uid="copy"), ["copy"])):
        there = displaced(WorldState(0.0, 0.0, ego, (actor,)), recorded)
        assert [a if a is moved else a.uid for a in there] == expected
    assert displaced(WorldState(0.0, 0.0, ego, (moved,)), None) == []


def pose_at(x: float, y: float, z: float) -> FloatArray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def test_only_the_ground_of_moved_actors_fades() -> None:
    """On the sample's scene: an unedited drive has its bytes, a moved car fades where it is as low as the road."""
    scene = open_scene(Path(__file__).parents[3] / "sample" / "scene")
    drive, uid, frame = scene.header.drive, "car-12", 10
    backend: Any = load_backend(scene)

    def image(shown: Drive, recorded: dict[str, Actor] | None) -> CameraFrame:
        backend.recorded_actors = recorded
        renderer = Renderer(backend)
        states, time_s = states_of(renderer, shown), float(drive.cameras["front_camera"].time_s[frame])
        camera = states.camera("front_camera", 480)
        return renderer.render(states.state(camera, time_s), camera, time_s, ("rgb", "instance"))

    assert (image(drive, drive.actors).rgb == image(drive, None).rgb).all()
    car = drive.actors[uid]
    aside = car.world_from_actor.at(0.0)[:3, 1] * 3.0
    moved = replace(car, world_from_actor=car.world_from_actor.transformed(pose_at(*aside)))
    edited = replace(drive, actors={**drive.actors, uid: moved})
    hard, soft = image(edited, None), image(edited, drive.actors)
    without = image(replace(drive, actors={k: v for k, v in drive.actors.items() if k != uid}), None)
    changed = np.abs(soft.rgb - hard.rgb).max(-1) > 0
    assert hard.instance is not None and changed.sum() > 20
    assert (hard.instance[changed] == hard.instances.index(uid) + 1).all(), "of it alone"
    between = np.clip(soft.rgb, np.minimum(hard.rgb, without.rgb), np.maximum(hard.rgb, without.rgb))
    np.testing.assert_allclose(between[changed], soft.rgb[changed], atol=0.02)
