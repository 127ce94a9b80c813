"""NCore: what the writer writes reads back to the same drive, and NCore's own API reads it. Skipped without `nvidia-ncore`."""

from __future__ import annotations

import json
import shutil
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from ncore_drive import HEIGHT, LENSES, WIDTH, MadeLog, ncore_drive
from numpy.typing import NDArray
from PIL import Image
from small_log import small_drive, small_image, write_small_log

from unisim_blender.core.cli.main import unisim
from unisim_blender.core.data.log import Log, Sweep, SweepGrid, log_digest
from unisim_blender.core.data.own_vehicle import given_outline
from unisim_blender.core.errors import OutputError
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose
from unisim_blender.core.lenses.mei import Mei
from unisim_blender.core.sensors.beam_tables import vlp16
from unisim_blender.core.sensors.camera import camera_rays, line_times, lines, pixel_grid
from unisim_blender.core.sensors.frames import LidarFrame
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.world.drive import Drive, Lidar
from unisim_street.street import build_street
from unisim_street.truth import truth_camera, truth_lidar

v4 = pytest.importorskip("ncore.data.v4", reason="nvidia-ncore is not installed: pip install '.[ncore]'")

from unisim_blender.core.formats.ncore.cuboids import euler_of, rotation_of  # noqa: E402
from unisim_blender.core.formats.ncore.write import EPOCH_US, NcoreWriter, write_ncore  # noqa: E402

POSE, RAY = 1e-6, 1e-6


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ncore") / "log"
    write_ncore(path, MadeLog())
    return path


@pytest.fixture(scope="module")
def log(folder: Path) -> Log:
    return open_log(folder)


@pytest.fixture(scope="module")
def loader(folder: Path) -> Any:
    """NCore's own loader."""
    return v4.SequenceLoaderV4(v4.SequenceComponentGroupsReader([folder / "all of it.json"]))


def assert_same_track(found: Trajectory, made: Trajectory, start_s: float, end_s: float) -> None:
    times = np.linspace(start_s, end_s, 501)
    np.testing.assert_allclose(found.at(times), made.at(times), atol=POSE, rtol=0)


@pytest.mark.parametrize(("off_m", "steady"), [(0.0, True), (0.004, True), (0.03, True), (0.15, False)])
def test_a_mount_that_all_but_stands_still_is_one(off_m: float, steady: bool, tmp_path: Path) -> None:
    """NCore's API gives the extrinsics of sensors that ride on the vehicle, and raises for those that do not."""
    made = MadeLog()
    camera = made.drive.cameras["distorted"]
    keys = np.linspace(-0.3, 0.8, 111)
    track = camera.world_from_camera.at(keys)
    first = made.drive.world_from_ego.times_s[0]
    truth = np.linalg.inv(made.drive.world_from_ego.at(first)) @ camera.world_from_camera.at(first)
    track[:, 2, 3] += off_m * np.sin(40 * keys)
    camera = replace(
        camera, world_from_camera=Trajectory.from_poses(keys, track) if off_m else camera.world_from_camera
    )
    made.drive = replace(made.drive, cameras={"distorted": camera}, lidars={})
    write_ncore(tmp_path / "log", made)
    store = tmp_path / "log/all of it.json"
    sensor = v4.SequenceLoaderV4(v4.SequenceComponentGroupsReader([store])).get_camera_sensor("distorted")
    if steady:
        np.testing.assert_allclose(sensor.T_sensor_rig, truth, rtol=0, atol=1.1 * off_m + 1e-6)
    else:
        with pytest.raises(ValueError):
            sensor.T_sensor_rig  # noqa: B018
    found = open_log(tmp_path / "log").drive.cameras["distorted"].world_from_camera
    times = np.array(list(camera.time_s.values()))
    assert np.abs(found.at(times) - camera.world_from_camera.at(times)).max() < POSE, "read back it has its own poses"


def angles(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angles between unit vectors (..., 3), exact for small ones."""
    return np.asarray(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1)))


def assert_same_drive(found: Drive, made: Drive) -> None:
    assert (found.name, found.frames, found.time_s) == (made.name, made.frames, made.time_s)
    np.testing.assert_allclose(found.world_origin, made.world_origin, atol=1e-12)
    start, end = made.time_s[made.frames[0]] - 0.2, made.time_s[made.frames[-1]] + 0.2
    assert_same_track(found.world_from_ego, made.world_from_ego, start, end)
    assert set(found.cameras) == set(made.cameras) and set(found.lidars) == set(made.lidars)
    for name, camera in made.cameras.items():
        other = found.cameras[name]
        assert other.time_s == camera.time_s and other.model.shutter == camera.model.shutter
        assert (other.model.width, other.model.height) == (camera.model.width, camera.model.height)
        assert_same_track(other.world_from_camera, camera.world_from_camera, start, end)
        for frame in camera.time_s:
            u, v = pixel_grid(camera.model)
            rays, mine = (camera_rays(one, one.time_s[frame], u, v) for one in (other, camera))
            assert angles(rays.directions, mine.directions).max() < RAY
            np.testing.assert_allclose(rays.origins, mine.origins, atol=POSE, rtol=0)
            np.testing.assert_array_equal(rays.time_s, mine.time_s)
    for name, lidar in made.lidars.items():
        assert_same_lidar(found.lidars[name], lidar, start, end)
    assert set(found.actors) == set(made.actors)
    for uid, actor in made.actors.items():
        read = found.actors[uid]
        assert (read.label, read.start_s, read.end_s, read.is_moving) == (
            (actor.label, actor.start_s, actor.end_s, actor.is_moving)
        )
        np.testing.assert_allclose(read.size_m, actor.size_m, atol=1e-12)
        first, last = max(actor.start_s, start), min(actor.end_s, end)
        assert_same_track(read.world_from_actor, actor.world_from_actor, first, last)


def assert_same_lidar(found: Lidar, made: Lidar, start_s: float, end_s: float) -> None:
    assert found.time_s == made.time_s
    assert_same_track(found.world_from_lidar, made.world_from_lidar, start_s, end_s)
    assert (found.phase is None) == (made.phase is None)
    for field in fields(made.model):
        a, b = getattr(found.model, field.name), getattr(made.model, field.name)
        assert (a is None) == (b is None), field.name
        if a is not None and (field.name != "start_azimuth_rad" or made.model.column_azimuth_rad is None):
            np.testing.assert_allclose(a, b, atol=3e-7, rtol=0, err_msg=field.name)
    for time in made.time_s.values() if made.model.beams else ():
        rays, mine = lidar_rays(found, time), lidar_rays(made, time)
        assert angles(rays.directions, mine.directions).max() < RAY
        np.testing.assert_allclose(rays.origins, mine.origins, atol=POSE, rtol=0)
        np.testing.assert_array_equal(rays.time_s, mine.time_s)


def in_order(sweep: Sweep) -> tuple[Sweep, NDArray[np.int64]]:
    """The sweep's returns by time, beam and distance, for comparison."""
    distance = np.linalg.norm(sweep.points - sweep.origins, axis=1)
    up = np.round((sweep.points - sweep.origins)[:, 2] / distance, 5)
    return sweep, np.lexsort((distance.round(3), up, np.round(sweep.time_s, 8)))


def assert_same_sweep(found: Sweep, made: Sweep) -> None:
    assert len(found.points) == len(made.points)
    (a, i), (b, j) = in_order(found), in_order(made)
    np.testing.assert_allclose(a.time_s[i], b.time_s[j], atol=1e-9, rtol=0)
    np.testing.assert_allclose(a.origins[i], b.origins[j], atol=POSE, rtol=0)
    offset, mine = a.points[i] - a.origins[i], b.points[j] - b.origins[j]
    far, near = np.linalg.norm(offset, axis=1), np.linalg.norm(mine, axis=1)
    assert angles(offset / far[:, None], mine / near[:, None]).max() < RAY
    np.testing.assert_allclose(far, near, rtol=1e-7)
    np.testing.assert_allclose(a.intensity[i], b.intensity[j], atol=1e-7)
    for name in ("ring", "column", "semantic"):
        np.testing.assert_array_equal(getattr(a, name)[i], getattr(b, name)[j])
    assert (a.rank is None) == (b.rank is None)
    if a.rank is not None and b.rank is not None:
        np.testing.assert_array_equal(a.rank[i], b.rank[j])


def assert_same_grid(found: SweepGrid, made: SweepGrid) -> None:
    for name in ("returned", "blocked"):
        np.testing.assert_array_equal(getattr(found, name), getattr(made, name))
    known = ~made.blocked
    assert angles(found.directions, made.directions)[known].max() < RAY
    np.testing.assert_allclose(found.origins[known], made.origins[known], atol=POSE, rtol=0)
    np.testing.assert_allclose(found.time_s[known], made.time_s[known], atol=1e-9, rtol=0)
    np.testing.assert_allclose(found.depth_m, made.depth_m, rtol=1e-6)
    assert (found.others is None) == (made.others is None)


def test_the_drive_reads_back(log: Log) -> None:
    assert_same_drive(log.drive, ncore_drive())
    assert log.missing == ("LiDAR side: no sweep of 1 of 4 frames",)
    assert getattr(log, "classes") == {"Bike, with rider": "deforming", "Car": "rigid", "Cones": "still"}  # noqa: B009


def test_sweeps_read_back_with_drops_and_all_returns(log: Log) -> None:
    made = MadeLog()
    for lidar in made.drive.lidars:
        assert log.sweep_frames(lidar) == made.sweep_frames(lidar)
        for frame in made.sweep_frames(lidar):
            sweep, mine = log.sweep(lidar, frame), made.sweep(lidar, frame)
            assert_same_sweep(sweep, mine)
            drops, given = sweep.drops, mine.drops
            assert drops is not None and given is not None and len(drops.time_s) == len(given.time_s) > 5
            i, j = (np.lexsort((x.directions[:, 2].round(5), x.time_s.round(8))) for x in (drops, given))
            assert angles(drops.directions[i], given.directions[j]).max() < RAY
            np.testing.assert_allclose(drops.origins[i], given.origins[j], atol=POSE, rtol=0)
            np.testing.assert_array_equal(drops.ring[i], given.ring[j])
            if made.drive.lidars[lidar].model.beams:
                assert_same_grid(log.sweep_grid(lidar, frame), made.sweep_grid(lidar, frame))


def test_images_and_masks_read_back(log: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path))
    made = MadeLog()
    for name in made.drive.cameras:
        assert log.image_frames(name) == made.image_frames(name)
        for frame in log.image_frames(name):
            assert np.abs(log.image(name, frame).astype(int) - made.image(name, frame)).max() < 12  # JPEG
            path = log.image_path(name, frame)
            assert path is not None and path.is_relative_to(tmp_path) and path == log.image_path(name, frame)
            with Image.open(path) as image:
                np.testing.assert_array_equal(np.asarray(image), log.image(name, frame))
    assert log.image_path("ideal", 77) is None
    mask = log.own_vehicle_mask("fisheye")  # type: ignore[attr-defined]
    wanted = made.own_vehicle_mask("fisheye")
    assert wanted is not None
    np.testing.assert_array_equal(mask, wanted)
    assert log.own_vehicle_mask("ideal") is None  # type: ignore[attr-defined]
    outline = given_outline(log, "fisheye", log.drive.cameras["fisheye"].model)
    assert outline is not None and outline[12] == 25 and outline[5] == HEIGHT


def test_ncores_loader_reads_it(loader: Any) -> None:
    made = MadeLog()
    assert loader.sequence_id == "all of it" and set(loader.camera_ids) == set(made.drive.cameras)
    assert set(loader.lidar_ids) == set(made.drive.lidars)
    at = loader.pose_graph.evaluate_poses("world", "world_global", np.array([EPOCH_US], np.uint64))[0]
    np.testing.assert_allclose(at[:3, 3], made.drive.world_origin)
    assert set(loader.get_camera_sensor("fisheye").get_mask_images()) == {"ego"}
    assert loader.get_camera_sensor("ideal").get_mask_images() == {}
    image = loader.get_camera_sensor("ideal").get_frame_handle(1).get_data().get_decoded_image()
    assert image.size == (WIDTH, HEIGHT)


def test_ncores_loader_gives_the_same_points(loader: Any) -> None:
    """NCore moves a sensor along arcs, ours along their chords: 0.2 mm on this bend, more before the first pose."""
    made = MadeLog()
    for name in made.drive.lidars:
        sensor = loader.get_lidar_sensor(name)
        assert sensor.frames_count == len(made.sweep_frames(name))
        for index, frame in enumerate(made.sweep_frames(name)):
            times = sensor.get_frame_ray_bundle_timestamp_us(index)
            poses = loader.pose_graph.evaluate_poses(name, "world", times)
            valid = sensor.get_frame_ray_bundle_return_valid_mask(index, return_index=0)
            distance = sensor.get_frame_ray_bundle_return_distance_m(index, return_index=0)
            local = sensor.get_frame_ray_bundle_direction(index) * distance[:, None]
            points = (np.einsum("nij,nj->ni", poses[:, :3, :3], local) + poses[:, :3, 3])[valid]
            mine = made.sweep(name, frame)
            wanted = mine.points[mine.rank == 0]
            apart = np.linalg.norm(points[:, None] - wanted[None], axis=-1).min(0)
            assert len(points) == len(wanted) and apart.max() < (3e-4 if frame else 1e-3)
            assert (~valid).sum() == len(mine.drops.time_s)  # type: ignore[union-attr]


def test_ncores_loader_gives_the_same_boxes(loader: Any) -> None:
    made, seen = ncore_drive(), set()
    for one in loader.get_cuboid_track_observations():
        actor = made.actors[one.track_id]
        pose = actor.world_from_actor.at((one.timestamp_us - EPOCH_US) / 1e6)
        np.testing.assert_allclose(one.bbox3.centroid, pose[:3, 3], atol=POSE)
        np.testing.assert_allclose(one.bbox3.dim, actor.size_m, atol=1e-9)
        assert one.class_id == actor.label
        rotation = pytest.importorskip("scipy.spatial.transform").Rotation.from_euler("xyz", one.bbox3.rot).as_matrix()
        np.testing.assert_allclose(rotation, pose[:3, :3], atol=1e-9)
        seen.add(one.track_id)
    assert seen == set(made.actors)


@pytest.mark.parametrize("name", LENSES)
def test_ncores_cameras_have_the_same_rays_and_times(name: str, loader: Any) -> None:
    pytest.importorskip("torch")
    sensors, torch = pytest.importorskip("ncore.sensors"), pytest.importorskip("torch")
    sensor = loader.get_camera_sensor(name)
    camera = ncore_drive().cameras[name]
    theirs = sensors.CameraModel.from_parameters(sensor.model_parameters, device="cpu", dtype=torch.float64)
    u, v = (x.ravel() for x in pixel_grid(camera.model))
    points = np.stack([u, v], -1)
    mine = camera.model.unproject(u, v)
    rays = theirs.image_points_to_camera_rays(torch.from_numpy(points)).numpy()
    there = np.isfinite(mine[:, 2]) & (np.arccos(mine[:, 2]) < camera.model.lens.max_angle_rad * 0.98)
    assert there.mean() > 0.8
    limit = 2e-4 if "ward" in name else 2e-6  # of f-theta, NCore solves one direction by a few steps
    assert angles(rays[there], mine[there]).max() < limit
    for index, frame in enumerate(sorted(camera.time_s, key=camera.time_s.__getitem__)):
        start, end = (sensor.frames_timestamps_us[index].astype(np.int64) - EPOCH_US) / 1e6
        relative = theirs.image_points_relative_frame_times(torch.from_numpy(points)).numpy()
        times = line_times(camera, camera.time_s[frame], lines(camera.model, u, v))
        np.testing.assert_allclose(start + relative * (end - start), times, atol=1.1e-6)


@pytest.mark.parametrize("name", ["roof", "side"])
def test_ncores_lidars_have_the_same_rays(name: str, loader: Any) -> None:
    sensors, torch = pytest.importorskip("ncore.sensors"), pytest.importorskip("torch")
    made = MadeLog()
    lidar = made.drive.lidars[name]
    parameters = loader.get_lidar_sensor(name).model_parameters
    theirs = sensors.RowOffsetStructuredSpinningLidarModel(parameters, device="cpu", dtype=torch.float64)
    frame = made.sweep_frames(name)[0]  # its phase is 0
    elements = np.mgrid[: lidar.model.beams, : lidar.model.columns].reshape(2, -1).T.copy()
    rays = theirs.elements_to_sensor_rays(torch.from_numpy(elements)).numpy()
    still = replace(lidar, world_from_lidar=Trajectory.from_poses(np.zeros(1), np.eye(4)[None]))
    mine = lidar_rays(still, lidar.time_s[frame]).directions.reshape(-1, 3)
    assert angles(rays, mine).max() < RAY


@pytest.mark.parametrize("part", ["all of it.json", "all of it.ncore4.zarr.itar"])
def test_a_sequence_opens_by_each_of_its_files(part: str, folder: Path, log: Log) -> None:
    assert open_log(folder / part).drive.frames == log.drive.frames


def test_a_log_of_another_layout_becomes_a_sequence(tmp_path: Path) -> None:
    """PandaSet's: no drops are given, so they are those of its beam table; images' bytes stay."""
    drive = write_small_log(tmp_path / "pandaset")
    source = open_log(tmp_path / "pandaset")
    told: list[tuple[str, int]] = []
    write_ncore(tmp_path / "ncore", source, on_capture=lambda name, frame: told.append((name, frame)))
    log = open_log(tmp_path / "ncore")
    assert_same_drive(log.drive, source.drive)
    assert len(told) == 2 * len(drive.frames)
    for frame in drive.frames:
        assert_same_sweep(log.sweep("pandar64", frame), source.sweep("pandar64", frame))
        assert_same_grid(log.sweep_grid("pandar64", frame), source.sweep_grid("pandar64", frame))
        path = source.image_path("front_camera", frame)
        assert path is not None
        assert log.encoded_image("front_camera", frame) == path.read_bytes()  # type: ignore[attr-defined]
        assert np.abs(log.image("front_camera", frame).astype(int) - small_image(frame)).max() < 12
    info = CliRunner().invoke(unisim, ["info", str(tmp_path / "ncore"), "--json"])
    assert info.exit_code == 0 and json.loads(info.output)["motion"] == {"Car": "rigid", "Cones": "still"}


def test_a_sequence_becomes_the_same_sequence(log: Log, tmp_path: Path) -> None:
    write_ncore(tmp_path / "again", log)
    again = open_log(tmp_path / "again")
    assert_same_drive(again.drive, log.drive)
    for lidar in ("roof", "side", "long"):
        assert_same_sweep(again.sweep(lidar, 1), log.sweep(lidar, 1))


def test_rendered_frames_of_a_street_become_a_sequence(tmp_path: Path) -> None:
    street = build_street(frames=2, width=64, height=36)
    coarse = replace(vlp16(), columns=90)
    lidar = replace(street.drive.lidars["pandar64"], model=coarse)
    drive = replace(street.drive, lidars={"pandar64": lidar})
    frames: dict[int, LidarFrame] = {}
    with NcoreWriter(tmp_path / "ncore", drive) as writer:
        for frame in drive.frames:
            rgb = truth_camera(street, drive, "front_camera", frame).rgb
            writer.write_image("front_camera", frame, np.rint(rgb * 255).astype(np.uint8))
            frames[frame] = truth_lidar(street, drive, "pandar64", frame)
            writer.write_sweep("pandar64", frame, frames[frame])
    log = open_log(tmp_path / "ncore")
    assert_same_drive(log.drive, drive)
    for frame, true in frames.items():
        grid = log.sweep_grid("pandar64", frame)
        assert 0.1 < true.returned.mean() < 1
        np.testing.assert_array_equal(grid.returned, true.returned)
        assert not grid.blocked.any() and angles(grid.directions, true.directions).max() < RAY
        np.testing.assert_allclose(grid.origins, true.origins, atol=POSE, rtol=0)
        np.testing.assert_allclose(grid.depth_m[true.returned], true.depth_m[true.returned], rtol=1e-6)


@pytest.mark.parametrize("part", ["", "bend.json", "bend.ncore4.zarr.itar"])
def test_surfels_of_one_sequence_are_not_anothers(part: str, tmp_path: Path) -> None:
    """Whether it was opened by its folder or by a file."""
    drive = small_drive()
    moved = replace(drive, world_from_ego=drive.world_from_ego.transformed(right=make_pose(np.ones(3), np.eye(4)[0])))
    for name, one in (("a", drive), ("b", moved)):
        with NcoreWriter(tmp_path / name, one) as writer:
            writer.write_image("front_camera", 0, small_image(0))
    shutil.copytree(tmp_path / "a", tmp_path / "elsewhere")
    first, second, copy = (log_digest(open_log(tmp_path / name / part)) for name in ("a", "b", "elsewhere"))
    assert first == copy != second


def test_nothing_of_images_and_sweeps_is_read_when_it_is_opened(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from unisim_blender.core.formats.ncore import components

    read: list[str] = []
    array = components.read_array

    def noted(*values: Any) -> Any:
        read.append(values[2])
        return array(*values)

    monkeypatch.setattr(components, "read_array", noted)
    log = open_log(folder)
    assert read == []
    log.image("ideal", 0)
    assert len(read) == 1


def test_angles_about_fixed_axes() -> None:
    rng = np.random.default_rng(3)
    scipy = pytest.importorskip("scipy.spatial.transform")
    for euler in [*rng.uniform(-3, 3, (50, 3)), (0.3, np.pi / 2, 0.7), (0.3, -np.pi / 2, 0.7)]:
        rotation = scipy.Rotation.from_euler("xyz", euler).as_matrix()
        np.testing.assert_allclose(rotation_of(np.array(euler)), rotation, atol=1e-12)
        np.testing.assert_allclose(rotation_of(np.array(euler_of(rotation))), rotation, atol=1e-9)


def write(path: Path, drive: Drive) -> None:
    with NcoreWriter(path, drive):
        pass


def test_what_ncore_has_no_place_for_is_one_sentence(tmp_path: Path) -> None:
    drive = ncore_drive()
    camera, lidar = drive.cameras["ideal"], drive.lidars["roof"]
    mei = replace(camera, model=replace(camera.model, lens=Mei(0.9)))
    level = replace(lidar, model=replace(lidar.model, elevation_rad=np.zeros(4)))
    cases: list[tuple[Drive, str]] = [
        (replace(drive, cameras={"ideal": mei}), "ideal: NCore has no lens of the type 'mei'"),
        (
            replace(drive, lidars={"roof": level}),
            "roof: NCore cannot hold its beam table: Row elevation angles must be",
        ),
        (replace(drive, lidars={"rig": lidar}), "names of their own, not 'rig'"),
    ]
    for wrong, sentence in cases:
        with pytest.raises(OutputError, match=sentence):
            write(tmp_path / "out", wrong)
        assert list(tmp_path.iterdir()) == []
    with pytest.raises(OutputError, match="times are positive, and epoch_us 0 makes one"):
        NcoreWriter(tmp_path / "out", drive, epoch_us=0)


def test_wrong_frames_are_one_sentence_and_nothing_is_half_written(tmp_path: Path) -> None:
    made = MadeLog()
    drive, image, sweep = made.drive, made.image("ideal", 0), made.sweep("roof", 0)
    late = replace(sweep, time_s=sweep.time_s + 9)
    lone = replace(sweep, rank=np.ones_like(sweep.ring))
    cases: list[tuple[Any, str]] = [
        (lambda w: w.write_image("none", 0, image), "the drive has no 'none' with a time of frame 0"),
        (lambda w: w.write_image("ideal", 99, image), "the drive has no 'ideal' with a time of frame 99"),
        (lambda w: w.write_image("ideal", 0, image[:5]), r"an image of \(5, 48, 3\) uint8 is none of 48x32"),
        (lambda w: w.write_image("ideal", 0, b"GIF89a"), "is neither JPEG nor PNG"),
        (lambda w: w.write_image("ideal", 0, b"\xff\xd8\xff"), "is broken"),
        (lambda w: [w.write_image("ideal", 0, image) for _ in range(2)], "has frame 0 already"),
        (lambda w: w.write_sweep("roof", 0, late), "rays in frame 0 that lie .* s outside of the drive"),
        (lambda w: w.write_sweep("roof", 0, lone), "a return of rank 1 or more has no return of rank 0"),
        (lambda w: w.write_mask("ideal", np.zeros((3, 3), bool)), r"a mask of \(3, 3\) bool is none of 48x32"),
    ]
    for call, sentence in cases:
        with pytest.raises(OutputError, match=sentence), NcoreWriter(tmp_path / "out", drive) as writer:
            call(writer)
        assert list(tmp_path.iterdir()) == []
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "of another").touch()
    with pytest.raises(OutputError, match="out: is there already"):
        NcoreWriter(tmp_path / "out", drive)


def test_a_name_that_is_no_files_is_another_in_files(tmp_path: Path) -> None:
    made = MadeLog(replace(ncore_drive({}), name="a/b: c"))
    write_ncore(tmp_path / "out", made)
    assert (tmp_path / "out" / "a-b- c.json").is_file()
    assert open_log(tmp_path / "out").drive.name == "a-b- c"


def test_a_drive_of_which_nothing_is_written_is_no_sequence(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="out: neither an image nor a sweep was written"):
        write(tmp_path / "out", ncore_drive())
    assert list(tmp_path.iterdir()) == []


def test_a_sensor_of_which_nothing_is_written_is_left_out(tmp_path: Path) -> None:
    made = MadeLog()
    with NcoreWriter(tmp_path / "out", made.drive) as writer:
        writer.write_sweep("roof", 1, made.sweep("roof", 1))
    log = open_log(tmp_path / "out")
    assert (list(log.drive.cameras), list(log.drive.lidars)) == ([], ["roof"])
    assert log.sweep_frames("roof") == (1,) and log.drive.frames == made.drive.frames
    assert log.missing == ("LiDAR roof: no sweep of 3 of 4 frames",)
