"""The procedural street converted to each layout reads back to the same drive, at the layout's precision."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

from unisim_blender.core.convert import ConvertSource, convert, open_source
from unisim_blender.core.data.images import encoded_image
from unisim_blender.core.data.log import Log, Sweep
from unisim_blender.core.errors import what_is_missing
from unisim_blender.core.formats.common.class_names import class_name
from unisim_blender.core.formats.pandaset.sensors import PANDAR64
from unisim_blender.core.formats.pandaset.write import PandasetWriter
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.formats.writers import writer_named
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.world.drive import LidarModel
from unisim_street.street import Street, build_street
from unisim_street.truth import truth_camera, truth_lidar

FRAMES = 8
CAMERAS = ("front_camera", "left_camera")
TABLE = LidarModel(
    np.radians(np.linspace(4.0, -24.0, 20)),
    np.radians(np.linspace(2.5, -2.5, 20)),
    columns=500,
    start_azimuth_rad=float(np.radians(171.0)),
    time_offset_s=0.0001,
)


@dataclass(frozen=True)
class Precision:
    """What a layout keeps: metres of points, origins, places of vehicle and cameras, boxes; seconds of rays; radians."""

    point: float
    origin: float
    time: float
    place: float
    turn: float
    box: float
    sweeps: int = FRAMES


KITTI = ("kitti", "kitti-tracking")
LAYOUTS = {
    "pandaset": Precision(1e-9, 1e-9, 1e-12, 1e-9, 1e-9, 1e-9),
    "ncore": Precision(1e-5, 1e-6, 1e-9, 1e-6, 1e-6, 1e-6),
    "nuscenes": Precision(2e-5, 1e-5, 1e-6, 3e-4, 3e-4, 2e-3),
    # poses once a turn; beams look 2.5 degrees beside their columns, so that their times are 0.7 ms off
    "kitti": Precision(1.5e-2, 1e-2, 1e-3, 5e-4, 3e-4, 5e-3),
    "kitti-tracking": Precision(1.5e-2, 1e-2, 1e-3, 5e-4, 3e-4, 5e-3),
    "argoverse2": Precision(2e-5, 3e-4, 1e-8, 3e-4, 3e-4, 1e-3),
}
INFERRED = (*KITTI, "argoverse2")
"""Layouts without a beam table: what did not return is found from what did."""


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> ConvertSource:
    """The street with a LiDAR of 20 beams and two cameras, as a log."""
    path = tmp_path_factory.mktemp("street") / "log"
    street = build_street(seed=11, frames=FRAMES, width=64, height=36, cameras=CAMERAS)
    lidar = replace(street.drive.lidars[PANDAR64], model=TABLE)
    drive = replace(street.drive, lidars={PANDAR64: lidar}, world_origin=np.array([321.5, -1200.25, 14.0]))
    writer = PandasetWriter(path, drive)
    for frame in drive.frames:
        for name in CAMERAS:
            writer.write_image(name, frame, _image(street, name, frame))
        writer.write_sweep(frame, {PANDAR64: truth_lidar(street, drive, PANDAR64, frame)})
        writer.write_cuboids(frame)
    writer.finish()
    return open_source(path)


def _image(street: Street, camera: str, frame: int) -> np.ndarray:  # type: ignore[type-arg]
    return np.asarray(np.rint(truth_camera(street, street.drive, camera, frame).rgb * 255), np.uint8)


@pytest.fixture(scope="module", params=LAYOUTS)
def made(
    request: pytest.FixtureRequest, source: ConvertSource, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Log]:
    """A layout's name and the log that was converted to it."""
    out = tmp_path_factory.mktemp(request.param) / "out"
    try:
        done = convert(source, writer_named(request.param), out)
    except ModuleNotFoundError as error:
        pytest.skip(what_is_missing(error))
    assert done.written > FRAMES and not done.reused
    return request.param, open_log(done.opens)


def late(layout: str, source: ConvertSource, log: Log) -> float:
    """The source's time of the log's 0 s: nuScenes' and KITTI's readers count from the first sweep's stamp or look ahead."""
    if layout in ("pandaset", "ncore"):
        return 0.0
    fired = source.log.drive.time_s[0] + TABLE.time_offset_s
    if layout == "nuscenes":
        return fired - TABLE.sweep_s / 2 / TABLE.columns
    if layout == "argoverse2":
        return fired - TABLE.sweep_s * (1.1 - 0.5 / TABLE.columns)
    return fired - TABLE.sweep_s + TABLE.sweep_s * 171.0 / 360.0  # clockwise from 171 degrees to ahead


def moved(source: ConvertSource, log: Log, late_s: float) -> FloatArray:
    """From the log's world to the source's: the readers put it where the vehicle first was."""
    start = source.log.drive.world_from_ego.at(late_s)[:3, 3]
    return np.asarray(start - log.drive.world_from_ego.at(0.0)[:3, 3])


def test_the_vehicle_drives_where_it_drove(source: ConvertSource, made: tuple[str, Log]) -> None:
    layout, log = made
    precision, late_s = LAYOUTS[layout], late(layout, source, log)
    assert len(log.drive.frames) == precision.sweeps
    times = np.linspace(log.drive.time_s[log.drive.frames[0]], log.drive.time_s[log.drive.frames[-1]], 40)
    found, truth = log.drive.world_from_ego.at(times), source.log.drive.world_from_ego.at(times + late_s)
    np.testing.assert_allclose(
        found[:, :3, 3] + moved(source, log, late_s), truth[:, :3, 3], rtol=0, atol=precision.place
    )
    np.testing.assert_allclose(found[:, :3, :3], truth[:, :3, :3], rtol=0, atol=precision.turn)
    if layout not in KITTI:
        np.testing.assert_allclose(
            log.drive.world_origin - moved(source, log, late_s), source.log.drive.world_origin, rtol=0, atol=1e-6
        )


def test_every_return_comes_back(source: ConvertSource, made: tuple[str, Log]) -> None:
    layout, log = made
    precision, late_s = LAYOUTS[layout], late(layout, source, log)
    move = moved(source, log, late_s)
    (name,) = log.drive.lidars
    truth = [source.log.sweep(PANDAR64, frame) for frame in source.log.drive.frames]
    points, origins, times, intensity, ring = (
        np.concatenate([getattr(sweep, part) for sweep in truth])
        for part in ("points", "origins", "time_s", "intensity", "ring")
    )
    tree = cKDTree(np.column_stack([points, 20 * times]))
    seen = []
    for frame in log.sweep_frames(name):
        sweep = log.sweep(name, frame)
        off, index = tree.query(np.column_stack([sweep.points + move, 20 * (sweep.time_s + late_s)]))
        assert np.abs(sweep.points + move - points[index]).max() < precision.point
        assert np.abs(sweep.time_s + late_s - times[index]).max() < precision.time
        assert np.abs(sweep.origins + move - origins[index]).max() < precision.origin
        step = 1 / 255 if layout == "argoverse2" else 0.0
        np.testing.assert_allclose(sweep.intensity, intensity[index], atol=step / 2 + 1e-6)
        # a layout without a beam table has those that return often enough, so from the lowest on
        lowest = TABLE.beams - log.drive.lidars[name].model.beams if layout == "argoverse2" else 0
        np.testing.assert_array_equal(sweep.ring + lowest, ring[index])
        seen.append(index)
    every = np.concatenate(seen)
    assert len(every) == len(np.unique(every)), "none twice"
    if layout in KITTI:
        # what lies before the first turn or behind the last is left out: 9 of 360 degrees here
        assert 0.99 * len(points) < len(every) < len(points)
    else:
        assert len(every) == len(points)


def test_what_did_not_return_is_known(source: ConvertSource, made: tuple[str, Log]) -> None:
    layout, log = made
    (name,) = log.drive.lidars
    late_s = late(layout, source, log)
    if (
        layout in INFERRED
    ):  # cut elsewhere, so cells are others; what is empty is inferred from the beams that the drive states
        found, truth = log.sweep_grid(name, 3), source.log.sweep_grid(PANDAR64, 3)
        assert found.returned.sum() >= 0.99 * len(log.sweep(name, 3).points)
        drops, lost = (int((~grid.returned & ~grid.blocked).sum()) for grid in (found, truth))
        # in Argoverse 2's layout nothing tells the vehicle's own shadow
        assert (0.8 if layout == "argoverse2" else 0.9) * lost < drops <= 1.05 * lost
        return
    for frame in (0, FRAMES - 1):
        found, truth = log.sweep_grid(name, frame), source.log.sweep_grid(PANDAR64, frame)
        np.testing.assert_array_equal(found.returned, truth.returned)
        known = ~found.blocked & ~truth.blocked
        assert known.mean() > 0.95 and (~truth.returned & known).sum() > 200
        assert np.abs(found.directions - truth.directions)[known].max() < 1e-5
        assert np.abs(found.time_s + late_s - truth.time_s)[known].max() < 1e-6


def test_images_are_what_they_were_and_where(source: ConvertSource, made: tuple[str, Log]) -> None:
    layout, log = made
    precision, late_s = LAYOUTS[layout], late(layout, source, log)
    names = {
        "nuscenes": ("CAM_FRONT", "CAM_BACK_LEFT"),
        "kitti": ("image_02",),
        "kitti-tracking": ("image_02",),
        "argoverse2": ("ring_front_center", "ring_side_left"),
    }.get(layout, CAMERAS)
    assert set(log.drive.cameras) == set(names)
    for name, of in zip(names, CAMERAS, strict=False):
        camera, truth = log.drive.cameras[name], source.log.drive.cameras[of]
        assert (camera.model.width, camera.model.height) == (64, 36)
        for value in ("fx", "fy", "cx", "cy"):  # NCore's are float32
            assert getattr(camera.model, value) == pytest.approx(getattr(truth.model, value), rel=1e-7)
        frames = log.image_frames(name)
        assert len(frames) == FRAMES
        by_time = sorted(frames, key=camera.time_s.__getitem__)
        for frame, own in zip(by_time, source.log.drive.frames, strict=True):
            exposed = camera.model.shutter.exposure_s(camera.time_s[frame])
            recorded = np.array(truth.model.shutter.exposure_s(truth.time_s[own]))
            if layout == "argoverse2":  # an image has one time
                recorded[:] = recorded.mean()
            np.testing.assert_allclose(np.array(exposed) + late_s, recorded, rtol=0, atol=1e-6)
            time = exposed[0]
            pose, other = camera.world_from_camera.at(time), truth.world_from_camera.at(time + late_s)
            place = pose[:3, 3] + moved(source, log, late_s)
            np.testing.assert_allclose(place, other[:3, 3], rtol=0, atol=precision.place)
            np.testing.assert_allclose(pose[:3, :3], other[:3, :3], rtol=0, atol=precision.turn)
            np.testing.assert_array_equal(log.image(name, frame), source.log.image(of, own))
            if layout not in KITTI:
                assert encoded_image(log, name, frame) == encoded_image(source.log, of, own)


def test_boxes_have_classes_and_tracks(source: ConvertSource, made: tuple[str, Log]) -> None:
    layout, log = made
    precision, late_s = LAYOUTS[layout], late(layout, source, log)
    actors, move = source.log.drive.actors, moved(source, log, late_s)
    matched = set()
    for uid, actor in log.drive.actors.items():
        times = actor.world_from_actor.times_s  # between annotated boxes they are interpolated
        places = actor.world_from_actor.at(times)[:, :3, 3] + move

        def off(other: str, times: FloatArray = times, places: FloatArray = places) -> float:
            return float(np.abs(actors[other].world_from_actor.at(times + late_s)[:, :3, 3] - places).max())

        own = uid if uid in actors else min(actors, key=off)
        matched.add(own)
        truth = actors[own]
        assert off(own) < precision.box, (uid, own)
        wanted = truth.label if layout == "ncore" else class_name(truth.label, layout.partition("-")[0])
        assert (actor.label, actor.is_moving) == (wanted, truth.is_moving)
        np.testing.assert_allclose(actor.size_m, truth.size_m, rtol=0, atol=1e-9)
        heading = actor.world_from_actor.at(times)[:, :3, 0]
        np.testing.assert_allclose(heading, truth.world_from_actor.at(times + late_s)[:, :3, 0], rtol=0, atol=0.02)
    assert len(log.drive.actors) == len(matched) > 8
    assert sum(actor.is_moving for actor in log.drive.actors.values()) >= 3
    # tracking labels are of what the camera sees
    assert matched == set(actors) or (layout == "kitti-tracking" and len(matched) < len(actors))
    if layout not in KITTI:
        assert set(log.drive.actors) == set(actors), "track ids are kept"


def test_the_first_frame_has_boxes(source: ConvertSource, made: tuple[str, Log]) -> None:
    """The first sweep begins before the first frame's time, and actors that are there then are there while it turns."""
    layout, log = made
    assert all(actor.present(0.0) for actor in source.log.drive.actors.values())
    # readers take an actor to be there from half a frame before its first box
    from_first = [actor for actor in log.drive.actors.values() if actor.start_s < log.drive.time_s[log.drive.frames[0]]]
    assert len(from_first) >= (6 if layout == "kitti-tracking" else len(source.log.drive.actors))


def test_nuscenes_tables_name_each_other(source: ConvertSource, tmp_path: Path) -> None:
    """What the dataset's own tools look up is there: every token, every file, and the LiDAR's points in each box."""
    import json

    root = convert(source, writer_named("nuscenes"), tmp_path / "out").opens
    tables = {path.stem: json.loads(path.read_text()) for path in (root / "v1.0-mini").glob("*.json")}
    assert tables.pop("splits") == {"converted": [tables["scene"][0]["name"]]}
    assert set(tables) == {
        "attribute", "calibrated_sensor", "category", "ego_pose", "instance", "log", "map", "sample",
        "sample_annotation", "sample_data", "scene", "sensor", "visibility",
    }  # fmt: skip
    tokens = {table: {row["token"]: row for row in rows} for table, rows in tables.items()}
    for rows in tables.values():
        for row in rows:
            for key, value in row.items():
                if key.endswith("_token") and value and key.removesuffix("_token") in tokens:
                    assert value in tokens[key.removesuffix("_token")], (key, value)
    for table in ("sample", "sample_data", "sample_annotation"):
        for row in tables[table]:
            for way, back in (("next", "prev"), ("prev", "next")):
                assert not row[way] or tokens[table][row[way]][back] == row["token"]
    for row in tables["sample_data"]:
        assert (root / row["filename"]).is_file()
        assert row["filename"].startswith("samples/" if row["is_key_frame"] else "sweeps/")
    assert (root / tables["map"][0]["filename"]).is_file()
    channels = {row["channel"] for row in tables["sensor"]}
    samples = tables["sample"]
    for sample in samples:
        keys = [row for row in tables["sample_data"] if row["is_key_frame"] and row["sample_token"] == sample["token"]]
        assert len(keys) == len(channels)
    counts = [row["num_lidar_pts"] for row in tables["sample_annotation"]]
    assert max(counts) > 20
    box = tables["sample_annotation"][counts.index(max(counts))]
    assert box["visibility_token"] == "4"  # the car beside the vehicle
    assert {row["visibility_token"] for row in tables["sample_annotation"]} >= {"1", "4"}
    at = [sample["token"] for sample in samples].index(box["sample_token"])
    frame = (0, 5, 7)[at]
    assert len(samples) == 3
    sweep: Sweep = source.log.sweep(PANDAR64, frame)
    actor = source.log.drive.actors[box["instance_token"]]
    inside = 0
    for point, time in zip(sweep.points, sweep.time_s, strict=True):
        local = np.linalg.inv(actor.world_from_actor.at(time)) @ [*point, 1.0]
        inside += bool((np.abs(local[:3]) <= actor.size_m / 2 + 1e-6).all())
    assert abs(inside - max(counts)) <= 2


def test_a_converted_image_is_the_street(made: tuple[str, Log]) -> None:
    layout, log = made
    name = {
        "nuscenes": "CAM_FRONT",
        "kitti": "image_02",
        "kitti-tracking": "image_02",
        "argoverse2": "ring_front_center",
    }.get(layout, "front_camera")
    frame = log.image_frames(name)[0]
    content = encoded_image(log, name, frame)
    assert isinstance(content, bytes)
    with Image.open(io.BytesIO(content)) as image:
        assert image.format == ("PNG" if layout in KITTI else "JPEG") and image.size == (64, 36)
    rgb = log.image(name, frame).astype(float)
    assert rgb[:8].mean() > rgb[-8:].mean() + 10, "the sky is brighter than the road"
