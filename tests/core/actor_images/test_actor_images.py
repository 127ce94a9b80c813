"""Where actors are seen best, the words for their colours, their names, and what is kept of them."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from small_log import write_small_log
from tiny_drive import tiny_drive

from unisim_blender.core.actor_images.best_views import SIZE_PX, ActorView, best_views, crop
from unisim_blender.core.actor_images.cache import cached_images, clear_fraction, image_folder, make_images
from unisim_blender.core.actor_images.names import class_name, full_name, group_of, plain_names, readable_names
from unisim_blender.core.actor_images.paint import (
    colour_word,
    ground_pixels,
    hue_word,
    paint_pixels,
    paint_points,
    painted_as,
    tone_of,
)
from unisim_blender.core.colour import srgb_from_linear
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import Trajectory, invert_pose, points_in_box, transform_points
from unisim_blender.core.world.drive import Actor, CameraModel

PAINTS = {
    "white": (0.80, 0.80, 0.78), "light grey": (0.40, 0.40, 0.41), "grey": (0.19, 0.19, 0.19),
    "black": (0.03, 0.03, 0.03),
    "red": (0.35, 0.03, 0.03), "orange": (0.70, 0.22, 0.02), "yellow": (0.75, 0.55, 0.05), "green": (0.05, 0.22, 0.09),
    "blue": (0.05, 0.12, 0.40), "brown": (0.18, 0.10, 0.05),
}  # fmt: skip
"""Linear reflectances."""
ASPHALT = (0.13, 0.13, 0.13)
LIGHTS = {
    "noon": (1.1, 1.1, 1.1),
    "overcast": (0.6, 0.6, 0.63),
    "dusk": (0.22, 0.22, 0.25),
    "evening sun": (0.7, 0.6, 0.5),
}


def pixels(
    reflectance: tuple[float, ...], light: tuple[float, ...], rng: np.random.Generator, count: int = 400
) -> NDArray[np.uint8]:
    """Pixels of a surface under a light, a little uneven and noisy, in sRGB."""
    shade = rng.uniform(0.85, 1.05, (count, 1))
    srgb = srgb_from_linear(np.asarray(np.array(reflectance) * light * shade, np.float32)) + rng.normal(
        0, 0.008, (count, 3)
    )
    return np.asarray(np.clip(255 * srgb + 0.5, 0, 255), np.uint8)


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("word", PAINTS)
def test_a_paint_has_the_same_word_under_any_light(word: str, light: str) -> None:
    rng = np.random.default_rng(1)
    ground = pixels(ASPHALT, LIGHTS[light], rng)
    tone = tone_of(pixels(PAINTS[word], LIGHTS[light], rng), ground, ground)
    assert tone is not None and colour_word([tone]) == word


def test_glass_and_tyres_among_the_paint_do_not_make_a_white_car_grey() -> None:
    rng = np.random.default_rng(2)
    ground = pixels(ASPHALT, LIGHTS["overcast"], rng)
    paint = np.concatenate(
        [pixels(PAINTS["white"], LIGHTS["overcast"], rng), pixels((0.02, 0.02, 0.02), LIGHTS["overcast"], rng, 150)]
    )
    tone = tone_of(paint, ground, ground)
    assert tone is not None and colour_word([tone]) == "white"


def test_views_count_by_their_weight_and_too_few_pixels_tell_nothing() -> None:
    rng = np.random.default_rng(3)
    ground = pixels(ASPHALT, LIGHTS["noon"], rng)
    red, black = (tone_of(pixels(PAINTS[word], LIGHTS["noon"], rng), ground, ground) for word in ("red", "black"))
    assert red is not None and black is not None
    assert colour_word([red, black], [100.0, 30.0]) == "red" and colour_word([red, black], [30.0, 100.0]) == "black"
    assert tone_of(ground[:3], ground, ground) is None and colour_word([]) == ""


def test_hues_go_round() -> None:
    words = [
        hue_word(60 * np.cos(angle), 60 * np.sin(angle), 50.0)
        for angle in np.radians([0, 30, 60, 90, 140, 260, 320, 350])
    ]
    assert words == ["red", "red", "orange", "yellow", "green", "blue", "purple", "red"]
    assert hue_word(2.0, 2.0, 50.0) == ""


def test_names_are_the_class_in_the_singular_and_a_number_by_id() -> None:
    names = [
        "Car",
        "Cones",
        "Bus",
        "Other Vehicle - Construction Vehicle",
        "Other Vehicle - Uncommon",
        "Animals - Other",
        "Road Barriers",
    ]
    singular = ["Car", "Cone", "Bus", "Construction Vehicle", "Other Vehicle", "Animal", "Road Barrier"]
    assert [class_name(name) for name in names] == singular
    actors = tiny_drive().actors
    more = {**actors, "b": replace(actors["car"], uid="b"), "a": replace(actors["car"], uid="a")}
    assert plain_names(more) == {"a": "Car 1", "b": "Car 2", "car": "Car 3", "cone": "Cone 1"}
    assert plain_names(dict(reversed(list(more.items())))) == plain_names(more)
    assert (
        readable_names(more, {"b": "white", "cone": ""})["b"] == "Car 2, white" and full_name("Cone 1", "") == "Cone 1"
    )


def test_every_class_has_a_group() -> None:
    groups = {
        "CAR": "Car, Pickup Truck, Other Vehicle - Uncommon, REGULAR_VEHICLE, vehicle.car, Van, TYPE_VEHICLE, Vehicle, "
        "automobile, other_vehicle, car, van",
        "TRUCK": "Medium-sized Truck, Semi-truck, Towed Object, Bus, Train, Trolley, Tram / Subway, Emergency Vehicle, "
        "Other Vehicle - Construction Vehicle, LARGE_VEHICLE, BOX_TRUCK, TRUCK_CAB, VEHICULAR_TRAILER, ARTICULATED_BUS, "
        "RAILED_VEHICLE, vehicle.bus.bendy, vehicle.truck, vehicle.construction, vehicle.emergency.police, Tram, "
        "LargeVehicle, heavy_truck, train_or_tram_car, trolley_bus, semitrailer, truck",
        "CYCLE": "Motorcycle, Bicycle, Other Vehicle - Pedicab, Personal Mobility Device, Motorized Scooter, "
        "WHEELED_DEVICE, WHEELED_RIDER, MOTORCYCLIST, BICYCLIST, vehicle.bicycle, human.pedestrian.personal_mobility, "
        "Cyclist, TYPE_CYCLIST, rider, motorbike",
        "PERSON": "Pedestrian, Pedestrian with Object, PEDESTRIAN, OFFICIAL_SIGNALER, STROLLER, WHEELCHAIR, "
        "human.pedestrian.construction_worker, human.pedestrian.wheelchair, Person_sitting, TYPE_PEDESTRIAN, person, "
        "stroller, wheelchair",
        "OTHER": "Cones, Animals - Bird, Signs, Construction Signs, CONSTRUCTION_BARREL, DOG, MESSAGE_BOARD_TRAILER, "
        "MOBILE_PEDESTRIAN_CROSSING_SIGN, movable_object.trafficcone, static_object.bicycle_rack, TYPE_SIGN, Misc, "
        "protruding_object, animal",
    }
    for group, labels in groups.items():
        assert {label: group_of(label) for label in labels.split(", ")} == dict.fromkeys(labels.split(", "), group)


def standing(uid: str, x: float, y: float, size: tuple[float, ...] = (4.5, 1.9, 1.5)) -> Actor:
    """A car that stands beside the tiny drive."""
    car = tiny_drive().actors["car"]
    trajectory = Trajectory(np.zeros(1), np.array([[x, y, size[2] / 2]]), np.array([[1.0, 0, 0, 0]]))
    return replace(car, uid=uid, size_m=np.array(size), world_from_actor=trajectory, is_moving=False)


def test_the_best_view_is_large_and_nothing_stands_before_it() -> None:
    drive = tiny_drive()
    drive = replace(
        drive,
        actors={
            "front": standing("front", 14.0, 0.0),
            "behind": standing("behind", 24.0, 0.0),
            "aside": standing("aside", 24.0, 4.0),
        },
    )
    views = best_views(drive, {"front": sorted(drive.time_s)}, most=1)
    (front,), (behind,), (aside,) = (views[uid] for uid in ("front", "behind", "aside"))
    assert front.visible == 1.0 and behind.visible < 0.35 and aside.visible > 0.9
    assert front.frame == max(drive.time_s) and front.inside == pytest.approx(1.0)  # the vehicle comes nearer
    assert front.score > aside.score > behind.score


def test_an_actor_that_no_image_shows_has_no_view() -> None:
    drive = tiny_drive()
    drive = replace(drive, actors={"back": standing("back", -20.0, 0.0)})
    assert best_views(drive, {"front": sorted(drive.time_s)}) == {"back": []}
    assert best_views(replace(drive, actors={"front": standing("front", 14.0, 0.0)}), {}) == {"front": []}


def view_of(actor: Actor, nearer: tuple[tuple[float, ...], ...] = ()) -> tuple[ActorView, CameraModel]:
    """The only actor of the tiny drive in its first image, four times as large."""
    drive = tiny_drive()
    camera = drive.cameras["front"]
    model = CameraModel(320, 180, 300.0, 300.0, 160.0, 90.0)
    drive = replace(drive, actors={actor.uid: actor}, cameras={"front": replace(camera, model=model)})
    ((view,),) = (best_views(drive, {"front": [0]})[actor.uid],)
    return replace(view, nearer=np.array(nearer, float).reshape(-1, 4)), model


def test_paint_lies_on_the_faces_that_the_camera_sees() -> None:
    actor = standing("car", 16.0, 5.0)
    view, model = view_of(actor)
    points = paint_points("Car", actor.size_m, view)
    local = transform_points(invert_pose(view.pose), points)
    assert len(points) > 50 and points_in_box(points, view.pose, actor.size_m + 1e-6).all()
    assert {round(float(x), 3) for x in local[:, 0] if abs(abs(x) - 2.25) < 1e-6} == {-2.25}  # the rear
    assert {round(float(y), 3) for y in local[:, 1] if abs(abs(y) - 0.95) < 1e-6} == {
        -0.95
    }  # the side towards the lane
    assert (
        not len(paint_points("Cones", actor.size_m, view))
        and painted_as("Pickup Truck") == "car"
        and painted_as("Bus") == "truck"
    )
    image = np.zeros((180, 320, 3), np.uint8)
    left, top, right, bottom = view.rectangle.round().astype(int)
    image[top:bottom, left:right] = 200
    assert len(paint_pixels(image, model, "Car", actor.size_m, view)) == len(points)
    assert (paint_pixels(image, model, "Car", actor.size_m, view) == 200).all()
    asphalt, ground = ground_pixels(image, model, actor.size_m, view)
    assert len(asphalt) and len(ground) and max((asphalt > 0).mean(), (ground > 0).mean()) < 0.03  # but for the edge
    ahead = view_of(standing("ahead", 16.0, 0.96))[0]  # its side is seen at a grazing angle only
    assert np.allclose(transform_points(invert_pose(ahead.pose), paint_points("Car", actor.size_m, ahead))[:, 0], -2.25)
    covered, _ = view_of(actor, ((0.0, 0.0, 320.0, 180.0),))
    assert not len(paint_pixels(image, model, "Car", actor.size_m, covered))


def test_returns_before_an_actor_cover_it() -> None:
    actor = standing("car", 16.0, 0.0)
    view, model = view_of(actor)
    y, z = (part.ravel() for part in np.meshgrid(np.linspace(-0.8, 0.8, 8), np.linspace(0.3, 1.3, 5)))
    own = np.column_stack([np.full(len(y), 13.8), y, z])
    fence = np.column_stack([np.full(len(y), 9.0), 0.6 * y, 1.6 + 0.6 * (z - 1.6)])
    assert clear_fraction(own, actor.size_m, view, model) == 1.0
    assert clear_fraction(np.concatenate([own, fence]), actor.size_m, view, model) == pytest.approx(0.5, abs=0.05)
    assert clear_fraction(fence, actor.size_m, view, model) == 0.0
    assert clear_fraction(fence[:2], actor.size_m, view, model) == 1.0  # too few to tell


def test_a_thumbnail_is_square_inside_the_image_and_dims_what_is_not_the_actor() -> None:
    actor = standing("car", 16.0, 0.0)
    view, _ = view_of(actor)
    image = np.full((180, 320, 3), 200, np.uint8)
    made = crop(image, view)
    assert (
        made.shape == (SIZE_PX, SIZE_PX, 3)
        and (made[SIZE_PX // 2, SIZE_PX // 2] == 200).all()
        and (made[0, 0] == 110).all()
    )
    assert (crop(image, replace(view, rectangle=np.array([300.0, 0.0, 320.0, 20.0]))) > 0).all()


def test_images_are_kept_until_the_log_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "log"
    write_small_log(path)
    log = open_log(path)
    assert cached_images(path) is None
    made = {one.uid: one for one in make_images(log)}
    assert set(made) == set(log.drive.actors) and cached_images(path) == made
    assert all(one.image is None or one.image.read_bytes().startswith(b"\x89PNG") for one in made.values())
    assert any(one.image for one in made.values())
    image = next(one.image for one in made.values() if one.image)
    image.unlink()
    assert cached_images(path) is None  # half of it is none of it
    list(make_images(log))
    index = image_folder(path) / "actors.json"
    index.write_text(json.dumps({"actors": 3}))
    assert cached_images(path) is None
    before = image_folder(path)
    (path / "meta" / "new").parent.mkdir(exist_ok=True)
    (path / "meta" / "new").write_text("")
    after = image_folder(path)
    assert after != before
    recorded = next((path / "camera").rglob("*.jpg"))
    times = recorded.stat()
    recorded.write_bytes(recorded.read_bytes()[::-1])  # as large as before, with the time of before
    os.utime(recorded, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert image_folder(path) != after


def test_nothing_of_it_needs_pillow_before_a_thumbnail_is_made() -> None:
    import subprocess

    code = "import sys, unisim_blender.core.actor_images.cache; sys.exit('PIL' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
