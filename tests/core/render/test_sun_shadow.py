"""Shadows of the sun that edits move: closed form, against the truth of a street, and the bits of parts of an image."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drive_frames import DriveFrames
from tiny_drive import tiny_drive, world_pose

from unisim_blender.core import native
from unisim_blender.core.geometry import FloatArray, Trajectory
from unisim_blender.core.meshes.hits import MeshActors
from unisim_blender.core.prepare.scenario import prepare_scenario
from unisim_blender.core.prepare.scenario_plan import RenderOptions, plan_scenario
from unisim_blender.core.render.changes import RenderedState, changed_regions
from unisim_blender.core.render.frame_shadows import FrameShadows
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.sun_shadow import ACTORS_FACING, ON_ACTORS, GroundBeside, capped, sun_shadows
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.world.drive import Actor, Box
from unisim_blender.core.world.encoding import decode_state, encode_state
from unisim_blender.core.world.light import Sun, SunKeys, Sunlight
from unisim_blender.core.world.replay import WorldState
from unisim_street.street import build_street
from unisim_street.street_truth import StreetTruth
from unisim_street.truth import truth_camera

SAMPLE = Path(__file__).parents[3] / "sample" / "scene"
SUN = Sun(30.0, 45.0, (0.7, 0.6, 0.5))
CAR = replace(
    tiny_drive().actors["car"],
    size_m=np.array([4.0, 2.0, 1.5]),
    world_from_actor=Trajectory(np.zeros(1), np.array([[0.0, 0, 0.75]]), np.array([[1.0, 0, 0, 0]])),
    is_moving=False,
)
EGO = Trajectory(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]))


class Boxes:
    """A tracer that sees the boxes of a state's actors exactly, above a plane at height 0."""

    def __init__(self, state: WorldState) -> None:
        self.state, self.active = state, type("Active", (), {"mesh_actors": MeshActors(())})

    def trace(self, rays: Rays, *_: Any) -> Any:
        depth = np.full(len(rays.time_s), np.inf)
        for actor in self.state.actors:
            near, far = slab(actor, rays.origins, rays.directions)
            depth = np.where((near <= far) & (far > 0.5), np.minimum(depth, np.maximum(near, 0.5)), depth)
        return type("Traced", (), {"maps": {"depth": depth}})

    def heights(self, points: FloatArray) -> FloatArray:
        return points[:, 2]


def slab(actor: Actor, origins: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    middle, half = actor.world_from_actor.positions[0], actor.size_m / 2
    a, b = (middle - half - origins) / directions, (middle + half - origins) / directions
    return np.minimum(a, b).max(1), np.maximum(a, b).min(1)


IN_SUN = GroundBeside(np.array([[0.0, 3.0, 0.0]]), np.array([0]), np.array([0.4]), 0.45)


def factors(
    state: WorldState, recorded: dict[str, Actor], points: FloatArray, beside: GroundBeside = IN_SUN
) -> FloatArray:
    parked = {uid: Box(a.world_from_actor.poses[0], a.size_m) for uid, a in recorded.items() if not a.is_moving}
    shadows = sun_shadows(state, tiny_drive().cameras["front"], recorded, parked)
    assert shadows is not None
    tracers: Any = {"edited": Boxes(shadows.edited), "recorded": Boxes(shadows.recorded)}
    nothing = np.zeros(len(points), np.int32)
    unlit = np.full(len(points), 0.01)
    return shadows.factors(
        points, np.zeros(len(points)), (), nothing, lambda some: np.zeros((some.sum(), 3)), tracers, unlit, lambda: beside
    )  # fmt: skip


def ground() -> tuple[FloatArray, Any, Any]:
    """Places beside the car, those in the shadow that its box casts, and those well outside of it."""
    x, y = (axis.reshape(-1) for axis in np.meshgrid(np.linspace(-9, 9, 91), np.linspace(-9, 9, 91)))
    points = np.stack([x, y, np.zeros_like(x)], -1)
    # the shadow at a point: the box's footprint, and that of its top, 1.5 m / tan(45 degrees) away from the sun
    away = 1.5 * np.array([np.cos(np.radians(30)), np.sin(np.radians(30))])

    def covered(grow: float) -> Any:
        steps = np.linspace(0, 1, 400)[:, None] * -away
        inside = np.abs(points[:, None, :2] - steps) <= np.array([2.0, 1.0]) + grow
        return inside.all(-1).any(1)

    return points, covered(-0.1), ~covered(0.5)


def test_an_inserted_box_shades_the_plane_by_the_suns_part_and_a_removed_one_gives_it_back() -> None:
    points, core, outside = ground()
    light = Sunlight(SUN, ("car",))
    inserted = WorldState(0.0, 0.0, EGO, (replace(CAR, inserted=True),), light=light)
    shaded = factors(inserted, {}, points)
    np.testing.assert_allclose(shaded[core], np.tile(1 - np.array(SUN.strength), (core.sum(), 1)), rtol=1e-6)
    assert core.sum() > 200 and (shaded[outside] == 1).all()
    box = Box(world_pose(0.0, 0.0, 0.75), CAR.size_m)
    removed = WorldState(0.0, 0.0, EGO, (), removed_boxes=(box,), light=replace(light, changed=()))
    given = factors(removed, {"car": CAR}, points)
    np.testing.assert_allclose(given[core], np.tile(1 / (1 - np.array(SUN.strength)), (core.sum(), 1)), rtol=1e-6)
    assert (given[outside] == 1).all()
    # one that comes where a parked one shades already takes nothing away a second time
    other = replace(CAR, uid="other", inserted=True)
    again = factors(WorldState(0.0, 0.0, EGO, (CAR, other), light=Sunlight(SUN, ("other",))), {"car": CAR}, points)
    assert (again == 1).all()
    # nor one where a building shades: ground there is as much darker than in the sun as the sun's part says
    shade = IN_SUN._replace(brightness=np.array([0.45 * 0.4]))
    assert (factors(inserted, {}, points, shade) == 1).all()
    assert (factors(removed, {"car": CAR}, points, shade) == 1).all()
    dark = replace(light, sun=replace(SUN, strength=(0.0, 0.0, 0.0)))
    assert (factors(replace(inserted, light=dark), {}, points) == 1).all()


def test_what_is_as_dark_as_a_recorded_shadow_is_lifted_to_the_ground_beside_and_nothing_else() -> None:
    wanted = np.full((4, 3), 2.5)
    # in a shadow, in half of one, lit, and brighter than the ground beside
    brightness = np.array([0.4 / 2.5, 0.4 / np.sqrt(2.5), 0.4, 0.8])
    lifted = capped(wanted, brightness, np.full(4, 0.4))
    np.testing.assert_allclose(lifted[:, 0], [2.5, 1, 1, 1])
    assert (capped(wanted, brightness, np.full(4, np.nan)) == 1).all()


def test_an_actor_has_the_sun_of_where_it_stands_by_the_ground_on_which_its_shadow_falls() -> None:
    recorded = replace(CAR, world_from_actor=Trajectory(np.zeros(1), np.array([[40.0, 0, 0.75]]), EGO.quaternions_wxyz))
    here = sun_shadows(
        WorldState(0.0, 0.0, EGO, (CAR,), light=Sunlight(SUN, ("car",))), tiny_drive().cameras["front"],
        {"car": recorded}, {"car": Box(recorded.world_from_actor.poses[0], CAR.size_m)},
    )  # fmt: skip
    assert here is not None
    (relit,) = here.relit
    places = np.concatenate([each[2] for each in relit.grounds])
    beside = GroundBeside(places[:1], np.array([0]), np.array([0.4]), 0.4)
    # in shade where x < 0 about the new place, in the sun about the recorded one
    brightness = np.where(places[:, 0] < 0, 0.4 * 0.4, 0.4)
    patches = here.patches(relit, places, np.ones(len(places), bool), brightness, beside)
    assert patches[1].visible.min() == 1 and patches[0].visible.min() == 0 and patches[0].visible.max() == 1
    # the third's shadow falls into the shade, 1.3 m away from the sun; the fourth's does not
    points = np.array([[-1.5, 0, 0.0], [1.5, 0, 0], [0.5, 0, 1.5], [1.9, 0, 1.5]])
    up = Rays(points, np.repeat([[0.0, 0, 1]], 4, 0), np.zeros(4))
    ratio = np.array(SUN.strength) / (1 - np.array(SUN.strength))
    less = 1 / (1 + ON_ACTORS * ACTORS_FACING * ratio)
    gain = here.gain(relit, patches, up, lambda points: points[:, 2])
    np.testing.assert_allclose(gain, [less, np.ones(3), less, np.ones(3)], rtol=1e-9)
    down = replace(up, directions=-up.directions)
    assert (here.gain(relit, patches, down, lambda points: points[:, 2]) == 1).all()
    nobody_knows = here.patches(relit, places, np.zeros(len(places), bool), brightness, beside)
    assert (here.gain(relit, nobody_knows, up, lambda points: points[:, 2]) == 1).all()


def test_ground_beside_one_changed_box_says_nothing_of_another() -> None:
    both = GroundBeside(np.array([[0.0, 3, 0], [1, 3, 0]]), np.array([0, 1]), np.array([0.4, 0.1]), 0.45)
    np.testing.assert_array_equal(both.level(np.array([[1.0, 3, 0]] * 3), np.array([0, 1, 2])), [0.4, 0.1, np.nan])


def test_light_is_part_of_a_state_only_where_an_edit_changes_something() -> None:
    state = WorldState(0.0, 0.0, EGO, (CAR,), light=Sunlight(SUN, ("car", "gone")))
    kept = state.with_changes_alone()
    assert kept.light == Sunlight(SUN, ("car",)) and kept != replace(kept, light=None)
    assert decode_state(encode_state(kept)) == kept and decode_state(encode_state(kept)).light == kept.light
    assert replace(state, light=Sunlight(SUN, ())).with_changes_alone().light is None
    keys = SunKeys(
        {"azimuth_deg": ((0.0, 10.0), (2.0, 30.0)), "elevation_deg": ((0.0, 50.0),), "strength": ((0.0, 0.5),)}
    )
    assert keys.at(1.0) == Sun(20.0, 50.0, (0.52, 0.5, 0.48))


pytestmark = pytest.mark.skipif(native.library() is None, reason="the kernels were not built")
NEW = {"type": "duplicate", "actor": "car-09", "id": "new", "pose": {"position": [22, 3.4, 1.05], "yaw_deg": 0}}


def written(folder: Path, name: str, **members: Any) -> Path:
    document = {
        "format": "unisim-scenario",
        "version": 1,
        "name": "lit",
        "log": "street",
        "scene": str(SAMPLE),
        **members,
    }
    (folder / f"{name}.json").write_text(json.dumps(document))
    return folder / f"{name}.json"


LIGHT = {"sun": {"azimuth_deg": -136.1, "elevation_deg": 53.65, "strength": 0.72}}


IN_SHADE = {**NEW, "pose": {"position": [19, -1.9, 1.05], "yaw_deg": 0}}


@pytest.mark.parametrize(
    ("edit", "frame", "least_db"),
    [(NEW, 4, 3), (IN_SHADE, 8, 3), ({"type": "remove", "actor": "car-10"}, 8, -0.1)],
    ids=["in the sun", "in a building's shade", "removed: its shadow was hidden"],
)
def test_shadows_of_a_stated_sun_are_nearer_to_the_truth(
    tmp_path: Path, edit: dict[str, Any], frame: int, least_db: float
) -> None:
    street, errors = build_street(), []  # that of the sample's scene
    for name, members in (("off", {}), ("on", {"light": LIGHT})):
        path = written(tmp_path, name, edits=[edit], **members)
        plan, _ = plan_scenario(path, RenderOptions(quality="fast"))
        renderer, camera = plan.recipe.load(), plan.captures.camera("front_camera")
        time_s = camera.time_s[frame]
        image = renderer.render(plan.captures.state(camera, time_s), camera, time_s).rgb
        edited = prepare_scenario(path).edited
        truth = StreetTruth(path, street, street.drive, edited, (frame,), ("front_camera",), None)
        true = truth.images("front_camera", frame)
        assert true.regions.shadow.sum() > 500
        errors.append(float(np.mean((image - true.edit)[true.regions.shadow] ** 2)))
    assert 10 * np.log10(errors[0] / errors[1]) > least_db


@pytest.mark.parametrize(
    ("actor", "place", "yaw_deg", "frame", "least_db"),
    [("car-13", [28, -2.6, 0.7], 180, 14, 2.5), ("car-10", [22, 3.2, 0.7], 0, 12, 1.0)],
    ids=["from the sun into a building's shade", "from there into the sun"],
)
def test_a_moved_car_is_nearer_to_the_truth_in_the_light_of_where_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, actor: str, place: list[float], yaw_deg: float, frame: int,
    least_db: float,
) -> None:  # fmt: skip
    move = {"type": "move", "actor": actor, "pose": {"position": place, "yaw_deg": yaw_deg}}
    path, street, errors = written(tmp_path, "moved", edits=[move], light=LIGHT), build_street(), []
    plan, _ = plan_scenario(path, RenderOptions(quality="fast"))
    renderer, camera = plan.recipe.load(), plan.captures.camera("front_camera")
    time_s = camera.time_s[frame]
    true = truth_camera(street, prepare_scenario(path).edited, "front_camera", frame)
    for _ in range(2):
        image = renderer.render(plan.captures.state(camera, time_s), camera, time_s, ("rgb", "instance"))
        numbers = image.instances.index(actor) + 1, true.instances.index(actor) + 1
        mine = np.asarray(image.instance == numbers[0]) & np.asarray(true.instance == numbers[1])
        assert mine.sum() > 500
        errors.append(float(np.mean((image.rgb - true.rgb)[mine] ** 2)))
        monkeypatch.setattr(FrameShadows, "relit", lambda self, pending, rays, image, maps: image)
    assert 10 * np.log10(errors[1] / errors[0]) > least_db


def test_parts_have_the_bits_of_the_whole_and_nothing_else_changes(tmp_path: Path) -> None:
    remove = {"type": "remove", "actor": "car-12"}
    weather = {"rain_mm_h": 10}

    def frames(name: str, **members: Any) -> DriveFrames:
        plan, _ = plan_scenario(written(tmp_path, name, **members), RenderOptions(quality="fast"))
        return DriveFrames(plan.recipe.load(), plan.drive)

    move = {"type": "move", "actor": "car-13", "pose": {"position": [24, -0.4, 0.7], "yaw_deg": 180}}
    plain, lit = frames("plain", edits=[]), frames("lit", edits=[NEW, remove, move], light=LIGHT)
    camera = plain.captures.camera("front_camera", 240)
    time_s, size = camera.time_s[4], (240, 135)
    unlit = frames("unedited", edits=[], light=LIGHT).state(camera, time_s)
    assert unlit == plain.state(camera, time_s)
    assert lit.state(lit.captures.lidar("pandar64"), 0.4).light is None
    for scene in (lit, frames("rain", edits=[NEW, remove, move], light=LIGHT, weather=weather)):
        state = scene.state(camera, time_s)
        whole = scene.renderer.render(state, camera, time_s).rgb
        part = scene.renderer.render(state, camera, time_s, region=Region(30, 50, 200, 120)).rgb
        np.testing.assert_array_equal(part, whole[50:120, 30:200])
        tiles = [tile.frame.rgb for tile in scene.renderer.progressive(state, camera, time_s, band=32)]
        # in rain bands may differ in the last bit, with light or without
        np.testing.assert_allclose(np.concatenate(tiles), whole, atol=0 if scene is lit else 1e-7, rtol=0)
    before = plain.renderer.render(plain.state(camera, time_s), camera, time_s).rgb
    after = lit.renderer.render(lit.state(camera, time_s), camera, time_s).rgb
    margin = lit.renderer.margin(lit.state(camera, time_s))
    first, second = (RenderedState(one.state(camera, time_s), (), margin) for one in (plain, lit))
    regions = changed_regions(lit.renderer, first, second, camera)
    assert regions is not None
    covered = np.zeros(size[::-1], bool)
    for region in regions:
        covered[region.top : region.bottom, region.left : region.right] = True
    assert not covered.all() and (before == after)[~covered].all()
