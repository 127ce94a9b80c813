"""The street that Cycles draws: its camera and surfaces beside the LiDAR's, cuts, what is drawn again
and what is not."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import OpenEXR
import pytest
from scipy.ndimage import map_coordinates, uniform_filter

from unisim_blender.core.errors import OutputError
from unisim_blender.core.evaluation.metrics import psnr
from unisim_blender.core.formats.pandaset.read import PandasetLog
from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose
from unisim_blender.core.lenses.mei import Mei
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole
from unisim_blender.core.sensors.camera import line_times, lines, pixel_directions, pixel_grid
from unisim_blender.core.sensors.unprojection import has_direction
from unisim_blender.core.world.drive import Box, CameraModel, Drive, RollingShutter, StaticCopy
from unisim_street.cycles.painter import CyclesPainter
from unisim_street.drawing.image_setup import Workshop, true_image_path
from unisim_street.drawing.path_tracer import MODULE, Order, draw_log
from unisim_street.paint.light import LAMP_DROP_M
from unisim_street.street import Street, build_street
from unisim_street.tracing.trace import make_bundles, trace
from unisim_street.truth import make_world, truth_camera

CAMERA = "front_camera"
WIDTH, HEIGHT = 64, 36


@pytest.fixture(scope="module")
def street() -> Street:
    return build_street(seed=3, frames=4, width=WIDTH, height=HEIGHT, engine="cycles", paths=4)


@pytest.fixture(scope="module")
def workshop(street: Street) -> Workshop:
    return Workshop(street)


@pytest.fixture
def painter() -> Any:
    yield CyclesPainter(4)
    bpy.ops.wm.read_factory_settings(use_empty=True)


def positions(painter: CyclesPainter, workshop: Workshop, drive: Drive, folder: Path, frame: int = 2) -> FloatArray:
    """Where one path of each pixel ends, street frame (H, W, 3); 0 in the sky."""
    scene = painter.scene
    painter.set_up_image(workshop.image_setup(drive, CAMERA, frame), 0)
    scene.view_layers[0].use_pass_position = True
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = 1, False, False
    settings = scene.render.image_settings
    settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth, settings.use_exr_interleave = "OPEN_EXR_MULTILAYER", "32", True
    scene.render.filepath = str(folder / "passes.exr")
    bpy.ops.render.render(write_still=True)
    model = drive.cameras[CAMERA].model
    with OpenEXR.File(str(folder / "passes.exr"), separate_channels=True) as file:
        channels = file.channels()
        names = {axis: next(name for name in channels if name.endswith(f"Position.{axis}")) for axis in "XYZ"}
        found = np.stack([channels[names[axis]].pixels for axis in "XYZ"], -1).astype(np.float64)
        return found.swapaxes(0, 1) if model.shutter.axis == "columns" else found


def check_against_the_tracer(
    street: Street, drive: Drive, found: FloatArray, frame: int = 2, least_on_movers: int = 31
) -> None:
    """Each path's end lies on its pixel's ray, at its row's time, where LiDAR's tracer ends too, moving
    things included."""
    camera = drive.cameras[CAMERA]
    model = camera.model
    points = found.reshape(-1, 3)
    solid = np.flatnonzero((points != 0).any(-1))
    assert len(solid) > 0.7 * len(points)
    points = points[solid]
    v, u = (side + 0.5 for side in np.divmod(solid, model.width))
    times = line_times(camera, camera.time_s[frame], lines(model, u, v))
    world = make_world(street, drive)
    poses = world.street_from_world @ camera.world_from_camera.at(times)
    to = points - poses[:, :3, 3]
    local = np.einsum("nij,ni->nj", poses[:, :3, :3], to)
    at_u, at_v, valid = model.project(local)
    shown = has_direction(model, u, v)
    assert valid[shown].all()
    across = np.stack([at_u - u, at_v - v])[:, shown]
    assert np.abs(across).max() < 0.01  # pixels; Cycles' first path leaves in the middle of its pixel
    way = np.linalg.norm(to, axis=1)
    hits = trace(world.placements, make_bundles(poses[:, None, :3, 3], (to / way[:, None])[:, None], times[:, None]))
    apart = np.abs(hits.t[:, 0] - way)
    assert np.quantile(apart, 0.995) < 1e-3  # a ray along an edge may just miss it
    moving = [number for number, place in enumerate(world.placements) if place.motion and len(place.motion.times_s) > 1]
    on_movers = np.isin(hits.placement[:, 0], moving)
    assert on_movers.sum() >= least_on_movers and np.quantile(apart[on_movers], 0.95) < 1e-3


def test_images_show_what_lidar_meets(
    street: Street, workshop: Workshop, painter: CyclesPainter, tmp_path: Path
) -> None:
    check_against_the_tracer(street, street.drive, positions(painter, workshop, street.drive, tmp_path))


@pytest.mark.slow
def test_so_do_images_of_a_scaled_car(
    street: Street, workshop: Workshop, painter: CyclesPainter, tmp_path: Path
) -> None:
    lead, factors = street.drive.actors["car-01"], (1.2, 1.5, 1.4)
    larger = replace(lead, size_m=lead.size_m * np.array(factors), scale=factors)
    drive = replace(street.drive, actors={**street.drive.actors, "car-01": larger})
    check_against_the_tracer(street, drive, positions(painter, workshop, drive, tmp_path))
    # and the next image, of which it is no part, has it as large as it was
    painter.set_up_image(workshop.image_setup(street.drive, CAMERA, 2), 0)
    assert tuple(painter._objects["car-01"].scale) == (1.0, 1.0, 1.0)


@pytest.mark.slow
def test_so_do_images_of_an_edited_drive(
    street: Street, workshop: Workshop, painter: CyclesPainter, tmp_path: Path
) -> None:
    skip = max(
        street.static.parts, key=lambda part: part.shape.high[0] == pytest.approx(1.8) and part.shape.high[1] < 1
    )
    assert skip.asset_from_part is not None
    at = skip.asset_from_part[:3, 3] - street.drive.world_origin
    source = Box(
        make_pose(at + [0.4, 0.0, 0.9], np.array([1.0, 0.0, 0.0, 0.0])), np.array([3.0, 2.2, 1.8])
    )  # through its middle
    target = source.world_from_box.copy()
    target[:3, 3] += [-8.0, 6.5, 0.0]
    lead = street.drive.actors["car-01"]
    poses = lead.world_from_actor.poses.copy()
    poses[:, 0, 3] -= 2.0
    moved = replace(lead, world_from_actor=Trajectory.from_poses(lead.world_from_actor.times_s, poses))
    camera = street.drive.cameras[CAMERA]
    aside = camera.world_from_camera.poses.copy()
    aside[:, 1, 3] += 1.0
    shifted = replace(camera, world_from_camera=Trajectory.from_poses(camera.world_from_camera.times_s, aside))
    actors = {uid: actor for uid, actor in street.drive.actors.items() if uid != "car-03"} | {"car-01": moved}
    edited = replace(
        street.drive,
        actors=actors,
        cameras={CAMERA: shifted},
        static_removals=(source,),
        static_copies=(StaticCopy("skip-2", source, target),),
    )
    before = positions(painter, workshop, street.drive, tmp_path)
    after = positions(painter, workshop, edited, tmp_path)
    assert (np.abs(after - before) > 0.1).any(-1).mean() > 0.3
    check_against_the_tracer(street, edited, after)
    again = positions(painter, workshop, street.drive, tmp_path)
    np.testing.assert_array_equal(again, before)  # what an edit took away is back


@pytest.mark.slow
def test_a_global_shutter_exposes_all_rows_at_once(
    street: Street, workshop: Workshop, painter: CyclesPainter, tmp_path: Path
) -> None:
    camera = street.drive.cameras[CAMERA]
    still = replace(camera, model=replace(camera.model, shutter=RollingShutter()))
    drive = replace(street.drive, cameras={CAMERA: still})
    check_against_the_tracer(street, drive, positions(painter, workshop, drive, tmp_path))


SIXTH = CameraModel(72, 40, 24.0, 25.0, 35.0, 21.0, RollingShutter(0.03), OpenCVFisheye(k1=-0.02, max_angle_deg=100))
THROUGH = {
    "fisheye, rows": SIXTH,
    "fisheye, columns from the right": replace(SIXTH, shutter=RollingShutter(-0.03, 0.3, "columns")),
    "strong distortion": CameraModel(64, 36, 45.0, 45.0, 33.0, 18.0, lens=OpenCVPinhole(k1=-0.25, k2=0.05, p1=0.002)),
    "mei": CameraModel(64, 36, 60.0, 60.0, 32.0, 18.0, RollingShutter(0.03, 0.0), Mei(1.6, -0.05)),
    "pinhole, columns": CameraModel(64, 36, 45.0, 46.0, 33.0, 18.0, RollingShutter(0.03, 0.5, "columns")),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name != "fisheye, rows")) for name in THROUGH]
)
def test_images_through_a_lens_show_what_lidar_meets(
    street: Street, workshop: Workshop, painter: CyclesPainter, tmp_path: Path, name: str
) -> None:
    drive = replace(street.drive, cameras={CAMERA: replace(street.drive.cameras[CAMERA], model=THROUGH[name])})
    check_against_the_tracer(street, drive, positions(painter, workshop, drive, tmp_path), least_on_movers=10)


@pytest.mark.slow
def test_an_image_through_a_lens_is_the_pinholes_resampled(workshop: Workshop, painter: CyclesPainter) -> None:
    """Colours, too; and after it a pinhole's image is what it was."""
    drive = workshop.street.drive
    wide = CameraModel(256, 160, 110.0, 110.0, 128.0, 80.0)
    model = CameraModel(64, 48, 24.0, 24.0, 32.0, 24.0, lens=OpenCVFisheye(k1=-0.02, max_angle_deg=80))

    def paint(model: CameraModel) -> FloatArray:
        seen = replace(drive, cameras={CAMERA: replace(drive.cameras[CAMERA], model=model)})
        return painter.paint(workshop.image_setup(seen, CAMERA, 2), 1) / 255.0

    pinhole, image = paint(wide), paint(model)
    u, v = pixel_grid(model)
    shown = has_direction(model, u, v)
    assert 0.3 < shown.mean() < 0.95 and (image[~shown] == 0).all() and image[shown].min(0).max() > 0
    at_u, at_v, ahead = wide.project(pixel_directions(model, u, v))
    both = shown & ahead & (at_u > 4) & (at_u < 252) & (at_v > 4) & (at_v < 156)
    assert both.sum() > 900
    blurred = uniform_filter(pinhole, (4, 4, 1))  # a pixel of the fisheye is four of the pinhole's wide
    wanted = np.stack([map_coordinates(blurred[..., i], [at_v[both], at_u[both]], order=1) for i in range(3)], -1)
    wrong = np.stack([map_coordinates(blurred[..., i], [at_v[both] + 12, at_u[both]], order=1) for i in range(3)], -1)
    off = np.abs(image[both] - wanted).mean()
    assert off < 0.05 and np.abs(image[both] - wrong).mean() > 2 * off
    np.testing.assert_array_equal(paint(wide) * 255, pinhole * 255)


@pytest.mark.slow
def test_a_seed_gives_the_same_image_and_another_the_same_street(
    street: Street, workshop: Workshop, painter: CyclesPainter
) -> None:
    setup = workshop.image_setup(street.drive, CAMERA, 1)
    image = painter.paint(setup, 1)
    np.testing.assert_array_equal(painter.paint(setup, 1), image)
    other = painter.paint(setup, 2)
    assert (other != image).any() and psnr(other / np.float32(255), image / np.float32(255)) > 24
    assert 0.2 < image.mean() / 255 < 0.7 and (image >= 254).mean() < 0.05
    sky, road = image[:4, 24:40].mean((0, 1)), image[-6:, 24:40].mean((0, 1))
    assert sky[2] > sky[0] + 20 and np.ptp(road) < 25


def synth(out: Path, *more: str) -> str:
    """Run `unisim synth` for a small street; what it said."""
    sizes = ["--frames", "2", "--width", "32", "--height", "18", "--paths", "2", "--seed", "3", "--range-noise", "0"]
    command = [sys.executable, "-m", "unisim_blender", "synth", str(out), *sizes, "--engine", "cycles", *more]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stderr


@pytest.mark.slow
def test_a_log_and_its_truth_are_drawn_once_and_completed(tmp_path: Path) -> None:
    out = tmp_path / "log"
    synth(out, "--edits", "--truth-frames", "1", "--quiet")
    log = PandasetLog(out)
    images = [out / "camera" / CAMERA / f"{frame:02d}.jpg" for frame in (0, 1)]
    assert log.image(CAMERA, 1).shape == (18, 32, 3)
    scenarios = sorted(path.stem for path in (out / "scenarios").iterdir())
    assert scenarios == ["cones", "insertion", "removal", "retiming", "shift-0.5m", "shift-2m", "shift-3m"]
    truths = sorted((out / "truth" / CAMERA).iterdir())
    assert len(truths) == len(scenarios) + 1  # each edit's, and the unedited drive's once
    assert len({path.read_bytes() for path in truths}) == len(truths)
    before = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in (*images, *truths)}
    images[1].unlink()
    truths[0].unlink()
    said = synth(out, "--edits", "--truth-frames", "1")
    assert "1/1" in said
    for path, (content, time) in before.items():
        assert path.read_bytes() == content, path
        assert (path.stat().st_mtime_ns == time) == (path not in (images[1], truths[0])), path


def test_the_drawing_process_ends_with_its_input_and_tells_what_is_wrong(tmp_path: Path) -> None:
    order = Order(tmp_path / "nowhere").text()
    done = subprocess.run(
        [sys.executable, "-m", MODULE, order], capture_output=True, text=True, stdin=subprocess.PIPE, timeout=100
    )
    assert done.returncode == 1
    with pytest.raises(OutputError, match="nowhere.*is missing"):
        draw_log(tmp_path / "nowhere", progress=False)


def test_lamps_light_a_night(street: Street, workshop: Workshop) -> None:
    """The street is lit below a dark sky, by lamps that stand where the exact street's do, and its truth has files of its own."""
    night = build_street(3, 4, WIDTH, HEIGHT, engine="cycles", paths=4, kind="night")
    images = []
    for shown, light in ((workshop, street.light), (Workshop(night), night.light)):
        painted = CyclesPainter(4, light)
        images.append(painted.paint(shown.image_setup(shown.street.drive, CAMERA, 2)).astype(float))
        lamps = [tuple(o.location) for o in painted.scene.objects if o.type == "LIGHT" and o.data.type == "POINT"]
        np.testing.assert_allclose(
            np.reshape(lamps, (-1, 3)), light.lamps.reshape(-1, 3) - [0, 0, LAMP_DROP_M], atol=1e-4
        )
        bpy.ops.wm.read_factory_settings(use_empty=True)
    day, dark = images
    assert dark.mean() < 0.7 * day.mean()
    exact = build_street(3, 4, WIDTH, HEIGHT)
    sky = np.asarray(truth_camera(exact, exact.drive, CAMERA, 2).opacity) == 0
    assert sky.sum() > 10 and dark[sky].mean() < 0.35 * day[sky].mean()
    assert dark[-HEIGHT // 3 :].mean() > dark[sky].mean()
    paths = {true_image_path(Path(), s, s.drive, CAMERA, 2, None) for s in (street, night)}
    assert len(paths) == 2
