"""Values that do not fit the ranges of a layout: read as what they certainly are, and otherwise said, by `info` and `train`.

The procedural street is written in each layout and changed as other people's converters write it: nothing of it is in order but
what is changed.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
pytest.importorskip("ncore", reason="the extra ncore is not installed")
pytest.importorskip("scipy", reason="the extra torch is not installed")

from ncore_by_hand import write_by_hand  # noqa: E402
from pyarrow import feather, parquet  # noqa: E402
from street_layouts import LAYOUTS  # noqa: E402

from unisim_blender.core.cli.main import unisim  # noqa: E402
from unisim_blender.core.data.image_files import SUFFIXES  # noqa: E402
from unisim_blender.core.data.values import RANGES, doubts, spread, time_unit  # noqa: E402
from unisim_blender.core.errors import LogError  # noqa: E402
from unisim_blender.core.formats.kitti.folders import read_labels  # noqa: E402
from unisim_blender.core.formats.pandaset.safe_pickle import read_table  # noqa: E402
from unisim_blender.core.formats.pandaset.write import write_table
from unisim_blender.core.formats.readers import open_log  # noqa: E402

FULL = {"pandaset": 255.0, "argoverse2": 255.0, "nuscenes": 255.0, "kitti": 1.0}
"""Of the layouts whose sweeps are files: what their intensities are full at."""
IMAGES = {"pandaset": ".jpg", "argoverse2": ".jpg", "nuscenes": ".jpg", "kitti": ".png"}
CAMERA = {"pandaset": "front_camera", "argoverse2": "ring_front_center", "nuscenes": "CAM_FRONT", "kitti": "image_02"}
LIDAR = {"pandaset": "pandar64", "argoverse2": "up_lidar", "nuscenes": "LIDAR_TOP", "kitti": "velodyne"}
LOGS = {"kitti": "2011_09_26/2011_09_26_drive_0001_sync"}
Table = dict[str, Any]


@pytest.fixture(scope="module")
def streets(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Gives the street in a layout, written when it is first asked for."""
    written: dict[str, Path] = {}

    def street(layout: str) -> Path:
        if layout not in written:
            root = tmp_path_factory.mktemp("street") / layout
            log = LAYOUTS[layout](root, 1).log
            assert log == root / LOGS.get(layout, "")
            (root / "meta" / "unisim.json").unlink(missing_ok=True)  # as the dataset's own
            if layout == "pandaset":  # some of its points are enough
                change_sweeps(log, layout, lambda table: table.update({key: part[::11] for key, part in table.items()}))
            written[layout] = root
        return written[layout]

    return street


@pytest.fixture
def copied(streets: Callable[[str], Path], tmp_path: Path) -> Callable[[str], Path]:
    """Gives a log of its own in a layout."""
    return lambda layout: Path(shutil.copytree(streets(layout), tmp_path / layout)) / LOGS.get(layout, "")


def info(path: Path) -> str:
    """What `unisim info` says of a log, or why it refuses it."""
    result = CliRunner().invoke(unisim, ["info", str(path)])
    return result.output + (str(result.exception) if result.exception else "")


def images(path: Path, layout: str) -> list[Path]:
    """The images of one camera."""
    folders = {
        "pandaset": "camera/front_camera", "argoverse2": "sensors/cameras/ring_front_center", "kitti": "image_02/data"
    }  # fmt: skip
    found = (path / folders[layout]).glob("*") if layout in folders else path.glob("*/CAM_FRONT/*")
    return sorted(file for file in found if file.suffix == IMAGES[layout])


def packed_anew(
    path: Path, layout: str, change: Callable[[Image.Image], Image.Image], suffix: str, **options: Any
) -> None:
    """Pack the images of one camera anew."""
    for file in images(path, layout):
        with Image.open(file) as image:
            new = change(image.convert("RGB"))
        file.unlink()
        quality: dict[str, Any] = {} if suffix in (".png", ".PNG", ".tif") else {"quality": 97}
        new.save(file.with_suffix(suffix), **quality, **options)


def change_sweeps(path: Path, layout: str, change: Callable[[Table], None]) -> None:
    """Change the columns x, y, z and i of all sweeps."""
    if layout == "pandaset":
        for file in sorted((path / "lidar").glob("*.pkl.gz")):
            table = {name: values.copy() for name, values in read_table(file).items()}
            change(table)
            write_table(file, table)
    elif layout == "argoverse2":
        for file in sorted((path / "sensors/lidar").glob("*.feather")):
            change_feather(file, lambda table: _under_i(table, change))
    else:
        for file in sorted(
            (path / "velodyne_points/data").glob("*.bin") if layout == "kitti" else path.rglob("*.pcd.bin")
        ):
            values = np.fromfile(file, "<f4").reshape(-1, 4 if layout == "kitti" else 5)
            columns: Table = dict(zip("xyzi", values.T.astype(np.float64), strict=False))
            change(columns)
            values[:, :4] = np.stack([columns[name] for name in "xyzi"], -1)
            values.tofile(file)


def _under_i(table: Table, change: Callable[[Table], None]) -> None:
    table["i"] = table.pop("intensity").astype(np.float64)
    change(table)
    table["intensity"] = table.pop("i")


def change_feather(file: Path, change: Callable[[Table], Any]) -> None:
    """Change the columns of a Feather file."""
    import pyarrow

    table = feather.read_table(str(file), memory_map=False)
    columns = {name: table[name].to_numpy().copy() for name in table.column_names}
    change(columns)
    feather.write_feather(pyarrow.table(columns), str(file), compression="uncompressed")


def change_json(file: Path, change: Callable[[Any], Any]) -> None:
    """Change a JSON document."""
    document = json.loads(file.read_text())
    file.write_text(json.dumps(change(document) or document))


# nothing is said of what is in order


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_street_is_not_doubted(streets: Callable[[str], Path], layout: str) -> None:
    log = open_log(streets(layout) / LOGS.get(layout, ""))
    assert doubts(log) == [] and log.drive.cameras and log.drive.lidars


REAL = Path(__file__).parents[4] / "shared" / "data"


@pytest.mark.parametrize(
    "name",
    [
        "pandaset/002",
        "argoverse2/val/7fab2350-7eaf-3b7e-a39d-6937a4c1bede",
        "kitti/raw_0005/2011_09_26/2011_09_26_drive_0005_sync",
        "kitti/raw_0009/2011_09_26/2011_09_26_drive_0009_sync",
    ],
)
def test_recorded_drives_are_not_doubted(name: str) -> None:
    if not (REAL / name).is_dir():
        pytest.skip(f"{REAL / name} is not there")
    assert doubts(open_log(REAL / name)) == []


def test_a_few_of_many_frames_are_looked_at() -> None:
    assert spread(range(1000)) == [0, 500, 999] and spread([7]) == [7] and spread([]) == [] and spread({3, 1}) == [1, 3]


def test_the_documentation_has_all_ranges() -> None:
    page = (Path(__file__).parents[3] / "docs/reference/logs.md").read_text(encoding="utf-8")
    for limits in RANGES:
        assert f"| {limits.what.rstrip(',')} | {limits.low:g} | {limits.high:g} | {limits.unit} |" in page


# images


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".jpeg", ".JPG", ".webp", ".tif"])
@pytest.mark.parametrize("layout", IMAGES)
def test_images_of_any_suffix_are_found(copied: Callable[[str], Path], layout: str, suffix: str) -> None:
    path = copied(layout)
    if layout == "nuscenes":  # of key frames and others the tables name the files
        assert len(images(path, layout)) > 2
    count = len(images(path, layout))
    before = open_log(path).image(CAMERA[layout], 1)
    packed_anew(path, layout, lambda image: image, suffix)
    log = open_log(path)
    assert len(log.image_frames(CAMERA[layout])) == count
    assert np.abs(log.image(CAMERA[layout], 1).astype(int) - before).mean() < 6
    assert not doubts(log) and CAMERA[layout] not in " ".join(log.missing)


@pytest.mark.parametrize("layout", ["pandaset", "argoverse2", "kitti"])
def test_of_two_files_of_a_frame_the_layouts_own_is_read_and_noted(copied: Callable[[str], Path], layout: str) -> None:
    path = copied(layout)
    first, own = images(path, layout)[0], open_log(path).image(CAMERA[layout], 0)
    other = first.with_suffix(next(suffix for suffix in SUFFIXES if suffix != IMAGES[layout]))
    Image.fromarray(255 - own).save(other)
    log = open_log(path)
    np.testing.assert_array_equal(log.image(CAMERA[layout], 0), own)
    assert f"{first}: is read, and {other.name} beside it is not" in " ".join(log.missing)
    first.unlink()
    assert np.abs(open_log(path).image(CAMERA[layout], 0).astype(int) - (255 - own)).mean() < 6


@pytest.mark.parametrize("layout", ["pandaset", "argoverse2", "kitti"])
def test_files_that_are_no_images_are_named(copied: Callable[[str], Path], layout: str) -> None:
    path = copied(layout)
    count = len(images(path, layout))
    for file in images(path, layout):
        file.rename(file.with_suffix(".npy"))
    assert f"(but {count} files .npy)" in info(path)


@pytest.mark.parametrize("layout", IMAGES)
def test_images_on_their_side_are_turned_and_noted(copied: Callable[[str], Path], layout: str) -> None:
    path = copied(layout)
    before, name = open_log(path), CAMERA[layout]
    exif = Image.Exif()
    exif[0x0112] = 6
    packed_anew(path, layout, lambda image: image.transpose(Image.Transpose.ROTATE_90), IMAGES[layout], exif=exif)
    log = open_log(path)
    assert log.drive.cameras[name].model == before.drive.cameras[name].model
    assert np.abs(log.image(name, 0).astype(int) - before.image(name, 0)).mean() < 6
    assert re.search(r"is turned to \d+x\d+ pixels \(EXIF orientation 6\)", info(path))


@pytest.mark.parametrize("layout", IMAGES)
def test_images_stored_on_their_side_without_a_tag_are_doubted(copied: Callable[[str], Path], layout: str) -> None:
    path = copied(layout)
    packed_anew(path, layout, lambda image: image.transpose(Image.Transpose.ROTATE_90), IMAGES[layout])
    assert "principal point" in info(path) or re.search(r"has \d+x\d+ pixels, (its table|intrinsics)", info(path))


@pytest.mark.parametrize("layout", IMAGES)
@pytest.mark.parametrize("share", [0.5, 0.75, 2])
def test_images_of_another_size_than_the_calibrations(copied: Callable[[str], Path], layout: str, share: float) -> None:
    path = copied(layout)
    packed_anew(
        path,
        layout,
        lambda image: image.resize((round(image.width * share), round(image.height * share))),
        IMAGES[layout],
    )
    said = info(path)
    assert "so the intrinsics are of another size" in said or re.search(
        r"has \d+x\d+ pixels, (its table|intrinsics)", said
    )


def test_kittis_stated_size(copied: Callable[[str], Path]) -> None:
    path = copied("kitti")
    file = path.parent / "calib_cam_to_cam.txt"
    text = file.read_text()
    file.write_text(f"{text}\nS_rect_02: 96 32\n")
    assert doubts(open_log(path)) == []
    file.write_text(f"{text}\nS_rect_02: 192 64\n")
    assert "0000000000.png: has 96x32 pixels, calib_cam_to_cam.txt gives 192x64" in info(path)
    file.write_text(f"{text}\nS_rect_02: -5 64\n")
    assert info(path).endswith("calib_cam_to_cam.txt: S_rect_02 is -5x64 pixels")


@pytest.mark.parametrize("layout", IMAGES)
def test_grey_of_16_bits_has_the_pixels_of_8(copied: Callable[[str], Path], layout: str) -> None:
    path = copied(layout)

    def grey(image: Image.Image) -> Image.Image:
        return Image.fromarray(np.asarray(image.convert("L")).astype(np.uint16) * 257)

    with Image.open(images(path, layout)[0]) as image:
        wanted = np.asarray(image.convert("L"))
    packed_anew(path, layout, grey, ".png")
    np.testing.assert_array_equal(open_log(path).image(CAMERA[layout], 0), np.repeat(wanted[..., None], 3, -1))


# intensities


@pytest.mark.parametrize("layout", FULL)
@pytest.mark.parametrize(("full", "whole"), [(1.0, False), (255.0, True), (255.0, False), (65535.0, True)])
def test_intensities_of_another_scale(copied: Callable[[str], Path], layout: str, full: float, whole: bool) -> None:
    path = copied(layout)
    before = open_log(path).sweep(LIDAR[layout], 1).intensity

    def scale(table: Table) -> None:
        values = table["i"] / FULL[layout] * full
        table["i"] = np.round(values) if whole and full > 1 else values

    change_sweeps(path, layout, scale)
    log = open_log(path)
    np.testing.assert_allclose(log.sweep(LIDAR[layout], 1).intensity, before, atol=0.003)
    if full == FULL[layout]:
        assert doubts(log) == []
    else:
        said = f"are not in the layout's range of 0 to {FULL[layout]:g}: they are taken as 0 to {full:g}"
        assert re.search(said, info(path))


@pytest.mark.parametrize("layout", FULL)
def test_intensities_below_zero_are_counted(copied: Callable[[str], Path], layout: str) -> None:
    path = copied(layout)

    def lower(table: Table) -> None:
        table["i"] = table["i"] - 0.1 * FULL[layout]

    change_sweeps(path, layout, lower)
    assert re.search(rf"\d+ of \d+ intensities lie outside of 0 to {FULL[layout]:g}, from -\S+ to", info(path))


def test_a_few_bright_ones_do_not_tell_another_scale(copied: Callable[[str], Path]) -> None:
    path = copied("kitti")
    before = open_log(path).sweep("velodyne", 0).intensity

    def outliers(table: Table) -> None:
        table["i"][7] = 40.0

    change_sweeps(path, "kitti", outliers)
    assert np.abs(open_log(path).sweep("velodyne", 0).intensity - before).max() <= 1
    assert "1 of" in info(path) and "are cut off there" in info(path)


@pytest.mark.parametrize("layout", ["argoverse2", "kitti"])
def test_intensities_that_fit_no_scale_are_refused(copied: Callable[[str], Path], layout: str) -> None:
    path = copied(layout)
    change_sweeps(path, layout, lambda table: table.update(i=table["i"] * 1e6))
    assert re.search(r"intensities from \S+ to \S+ fit no scale: the layout's is 0 to", info(path))


@pytest.mark.parametrize("factor", [2 * 255, 65535])
def test_ncores_intensities_of_another_scale(tmp_path: Path, factor: float) -> None:
    import zarr

    path = write_by_hand(tmp_path, store="directory")
    for file in tmp_path.rglob("intensity/.zarray"):
        array = zarr.open_array(str(file.parent), mode="r+")
        array[...] = array[...] * np.float32(factor)
    log = open_log(path)
    full = 255 if factor == 510 else 65535
    assert np.unique(log.sweep("roof", 1).intensity).tolist() == pytest.approx([factor / 2 / full])
    assert any(f"the layout's range of 0 to 1: they are taken as 0 to {full}" in sentence for sentence in doubts(log))


@pytest.mark.parametrize(("value", "said"), [(0, "have the intensity 0"), (200, "have the intensity 1")])
def test_waymos_intensities_that_were_lost_or_are_whole_numbers(
    copied: Callable[[str], Path], value: int, said: str
) -> None:
    """Of those of the layout tanh is taken."""
    import pyarrow

    path = copied("waymo")
    (file,) = (path / "lidar").glob("*.parquet")
    table = parquet.read_table(str(file))
    for name in table.column_names:
        if name.endswith(".values"):
            rows = [None if row is None else np.reshape(row, (-1, 4)) for row in table[name].to_pylist()]
            for row in rows:
                if row is not None:
                    row[:, 1] = value
            lists = pyarrow.array([None if row is None else row.ravel().tolist() for row in rows], table[name].type)
            table = table.set_column(table.column_names.index(name), name, lists)
    parquet.write_table(table, str(file), row_group_size=3)
    assert re.search(rf"100% of the returns {said}", info(path))


# points


@pytest.mark.parametrize("layout", ["pandaset", "argoverse2", "kitti"])
@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "milli"), (100.0, "centi"), (0.001, "kilo")])
def test_points_in_another_unit_are_said(copied: Callable[[str], Path], layout: str, factor: float, unit: str) -> None:
    path = copied(layout)
    if layout == "argoverse2" and factor > 1:
        pytest.skip("float16 has no such numbers")

    def scale(table: Table) -> None:
        for axis in "xyz":
            table[axis] = (table[axis] * factor).astype(table[axis].dtype)

    change_sweeps(path, layout, scale)
    said = info(path)
    assert f"{unit}metres" in said or re.search(r"point \d+ is at|no point of it|do not turn|lie on a beam", said), said


@pytest.mark.parametrize("layout", ["pandaset", "argoverse2", "kitti"])
def test_points_at_zero_are_no_returns(copied: Callable[[str], Path], layout: str) -> None:
    path = copied(layout)
    before = len(open_log(path).sweep(LIDAR[layout], 1).points)

    def empty(table: Table) -> None:
        for axis in "xyz":
            table[axis][::10] = 0

    change_sweeps(path, layout, empty)
    assert len(open_log(path).sweep(LIDAR[layout], 1).points) == pytest.approx(0.9 * before, rel=0.02)
    if layout != "kitti":
        assert re.search(r"\d+ of \d+ points are at 0, 0, 0: they are no returns", info(path))


# times


@pytest.mark.parametrize(("unit_s", "start_s"), [(1e-3, 0.0), (1e-6, 1.6e9), (1e-9, 1.6e9)])
def test_pandasets_times_in_another_unit_are_converted(
    copied: Callable[[str], Path], unit_s: float, start_s: float
) -> None:
    path = copied("pandaset")
    before = open_log(path).drive
    for file in path.rglob("timestamps.json"):
        change_json(file, lambda times: [(time + start_s) / unit_s for time in times])
    change_sweeps(path, "pandaset", lambda table: table.update(t=(table["t"] + start_s) / unit_s))
    log = open_log(path)
    np.testing.assert_allclose(list(log.drive.time_s.values()), list(before.time_s.values()), atol=1e-5)
    assert abs(log.sweep("pandar64", 1).time_s.mean() - log.drive.time_s[1]) < 0.1
    assert f"{unit_s:g} s are taken as their unit" in info(path)


def test_the_unit_of_times() -> None:
    assert time_unit(np.array([0.0, 0.1, 0.2])) == 1 and time_unit(np.array([5.0])) == 1
    assert [time_unit(np.array([0, 0.1, 0.2]) / unit) for unit in (1e-3, 1e-6, 1e-9)] == [1e-3, 1e-6, 1e-9]


def nuscenes_stamps(path: Path, factor: float) -> None:
    for table in ("sample", "sample_data", "ego_pose"):
        for file in path.rglob(f"{table}.json"):
            change_json(file, lambda rows: [row | {"timestamp": int(row["timestamp"] * factor)} for row in rows])


def argoverse_stamps(path: Path, factor: float) -> None:
    for file in (path / "annotations.feather", path / "city_SE3_egovehicle.feather"):
        change_feather(file, lambda t: t.update(timestamp_ns=(t["timestamp_ns"] * factor).astype(np.int64)))
    for file in sorted((path / "sensors").rglob("*.*")):
        file.rename(file.with_name(f"{int(int(file.stem) * factor)}{file.suffix}"))


def waymo_stamps(path: Path, factor: float) -> None:
    import pyarrow

    for file in path.rglob("*.parquet"):
        table = parquet.read_table(str(file))
        name = "key.frame_timestamp_micros"
        if name in table.column_names:
            stamps = pyarrow.array([int(stamp * factor) for stamp in table[name].to_pylist()], pyarrow.int64())
            parquet.write_table(table.set_column(table.column_names.index(name), name, stamps), str(file))


@pytest.mark.parametrize(
    ("layout", "change", "factor"),
    [
        ("nuscenes", nuscenes_stamps, 1000.0),
        ("nuscenes", nuscenes_stamps, 0.001),
        ("argoverse2", argoverse_stamps, 1e-3),
        ("waymo", waymo_stamps, 1000.0),
        ("waymo", waymo_stamps, 0.001),
    ],
)
def test_stamps_in_another_unit_are_refused(
    copied: Callable[[str], Path], layout: str, change: Callable[[Path, float], None], factor: float
) -> None:
    path = copied(layout)
    change(path, factor)
    said = info(path)
    assert len(said.splitlines()) == 1 and (str(path) in said)
    assert re.search(
        r"is \S+ s, not 0.002 to 10 s|are less than 1 ms apart|the poses' times, .* are not the frames'|beyond 2\^53|"
        r"ns is not later than the row before",
        said,
    ), said


def test_points_without_times_of_their_own_are_said(copied: Callable[[str], Path]) -> None:
    path = copied("pandaset")
    change_sweeps(path, "pandaset", lambda table: table.update(t=np.full_like(table["t"], table["t"].max())))
    assert "the time from a sweep's first return to its last, in turns, is 0, not 0.2 to 3" in info(path)


def test_offsets_in_microseconds_are_said(copied: Callable[[str], Path]) -> None:
    path = copied("argoverse2")
    for file in sorted((path / "sensors/lidar").glob("*.feather")):
        change_feather(file, lambda table: table.update(offset_ns=table["offset_ns"] // 1000))
    assert re.search(r"the time of a LiDAR's turn is \S+ s, not 0.01 to 1 s, as if", info(path))


def test_images_of_another_clock_are_said(copied: Callable[[str], Path]) -> None:
    path = copied("pandaset")
    for file in (path / "camera").rglob("timestamps.json"):
        change_json(file, lambda times: [time + 18.0 for time in times])
    assert re.search(r"the time from the drive's frames to a capture is 17.\d+ s, not 0 to 1 s", info(path))


# poses


def change_poses(path: Path, layout: str, place: float, order: list[int]) -> None:
    """Scale the vehicle's places, and its sensors', and put their quaternions' numbers, w x y z, in another order."""

    def row(row: Any) -> Any:
        return row | {
            "translation": [x * place for x in row["translation"]], "rotation": [row["rotation"][at] for at in order]
        }  # fmt: skip

    def pose(pose: Any) -> Any:
        values = [pose["heading"][name] for name in "wxyz"]
        heading = dict(zip("wxyz", (values[at] for at in order), strict=True))
        return {"position": {axis: x * place for axis, x in pose["position"].items()}, "heading": heading}

    def columns(table: Table) -> None:
        values = [table[name].copy() for name in ("qw", "qx", "qy", "qz")]
        table.update(zip(("qw", "qx", "qy", "qz"), (values[at] for at in order), strict=True))
        for name in ("tx_m", "ty_m", "tz_m"):
            table[name] = table[name] * place

    if layout == "pandaset":
        for file in path.rglob("poses.json"):
            change_json(file, lambda poses: [pose(one) for one in poses])
    elif layout == "nuscenes":
        for name in ("ego_pose", "calibrated_sensor") if order != WXYZ else ("ego_pose",):
            for file in path.rglob(f"{name}.json"):
                change_json(file, lambda rows: [row(one) for one in rows])
    else:
        change_feather(path / "city_SE3_egovehicle.feather", columns)
        if order != WXYZ:
            change_feather(path / "calibration/egovehicle_SE3_sensor.feather", columns)


WXYZ, XYZW = [0, 1, 2, 3], [1, 2, 3, 0]


@pytest.mark.parametrize("layout", ["pandaset", "argoverse2", "nuscenes"])
def test_quaternions_with_the_scalar_last_are_said(copied: Callable[[str], Path], layout: str) -> None:
    path = copied(layout)
    change_poses(path, layout, 1.0, XYZW)
    said = info(path)
    assert re.search(r"(tilt|looks and where it goes|image's up and the world's) is \S+ degrees, not 0 to", said), said


@pytest.mark.parametrize("layout", ["pandaset", "argoverse2", "nuscenes"])
@pytest.mark.parametrize(("place", "unit"), [(1000.0, "milli"), (100.0, "centi")])
def test_poses_in_another_unit_are_said(copied: Callable[[str], Path], layout: str, place: float, unit: str) -> None:
    path = copied(layout)
    change_poses(path, layout, place, WXYZ)
    said = info(path)
    assert re.search(
        rf"speed is \S+ m/s, not 0 to 100 m/s, as if it were given in {unit}metres|more than 1e|\d m$|m away", said
    ), said


def test_turns_the_other_way_are_said(copied: Callable[[str], Path]) -> None:
    """Poses of the world in the vehicle's frame, in place of the vehicle's in the world."""
    path = copied("pandaset")
    change_json(
        path / "lidar/poses.json",
        lambda poses: [
            pose | {"heading": {name: value * (1 if name == "w" else -1) for name, value in pose["heading"].items()}}
            for pose in poses
        ],
    )
    assert re.search(r"where the vehicle looks and where it goes is \S+ degrees, not 0 to 45", info(path))


@pytest.mark.parametrize("layout", ["nuscenes", "argoverse2", "kitti"])
def test_mounts_in_millimetres_are_said(copied: Callable[[str], Path], layout: str) -> None:
    path = copied(layout)
    if layout == "nuscenes":
        for file in path.rglob("calibrated_sensor.json"):
            change_json(
                file, lambda rows: [row | {"translation": [x * 1e3 for x in row["translation"]]} for row in rows]
            )
    elif layout == "argoverse2":
        change_feather(
            path / "calibration/egovehicle_SE3_sensor.feather",
            lambda table: table.update({name: table[name] * 1e3 for name in ("tx_m", "ty_m", "tz_m")}),
        )
    else:
        file = path.parent / "calib_velo_to_cam.txt"
        lines = file.read_text().splitlines()
        file.write_text("\n".join(_scaled(line) if line.startswith("T:") else line for line in lines))
    said = info(path)
    assert re.search(
        r"distance from the vehicle's origin is \S+ m, not 0 to 30 m, as if it were given in (milli|centi)metres", said
    ), said


def _scaled(line: str) -> str:
    name, *values = line.split()
    return " ".join([name, *(str(float(value) * 1e3) for value in values)])


# intrinsics


@pytest.mark.parametrize("layout", IMAGES)
def test_intrinsics_as_shares_of_the_image_or_in_millimetres_are_said(
    copied: Callable[[str], Path], layout: str
) -> None:
    path = copied(layout)
    share = 1 / open_log(path).drive.cameras[CAMERA[layout]].model.width
    if layout == "pandaset":
        for file in path.rglob("intrinsics.json"):
            change_json(file, lambda values: {name: value * share for name, value in values.items()})
    elif layout == "argoverse2":
        names = ("fx_px", "fy_px", "cx_px", "cy_px")
        change_feather(
            path / "calibration/intrinsics.feather", lambda t: t.update({name: t[name] * share for name in names})
        )
    elif layout == "nuscenes":

        def small(row: Any) -> Any:
            k = row["camera_intrinsic"]
            return row | {"camera_intrinsic": [[x * share for x in line] for line in k[:2]] + k[2:]}

        for file in path.rglob("calibrated_sensor.json"):
            change_json(file, lambda rows: [small(row) for row in rows])
    else:
        file = path.parent / "calib_cam_to_cam.txt"
        lines = [line.split() for line in file.read_text().splitlines()]
        for line in lines:
            if line and line[0].startswith("P_rect"):
                line[1:9] = [str(float(value) * share) for value in line[1:9]]
        file.write_text("\n".join(" ".join(line) for line in lines))
    said = info(path)
    assert re.search(
        r"principal point \S+, \S+: (it is near the middle of an image \S+ times as small|the principal)", said
    ), said
    assert "horizontal field of view is" in said


# boxes


def change_boxes(path: Path, layout: str, change: Callable[[list[float]], list[float]]) -> None:
    """Change length, width and height of all boxes."""
    if layout == "pandaset":
        for file in sorted((path / "annotations/cuboids").iterdir()):
            table = {name: values.copy() for name, values in read_table(file).items()}
            names = [f"dimensions.{axis}" for axis in "yxz"]
            new = np.array([change(list(row)) for row in np.stack([table[name] for name in names], -1)]).reshape(-1, 3)
            write_table(file, table | dict(zip(names, new.T, strict=True)))
    elif layout == "argoverse2":

        def columns(table: Table) -> None:
            names = ("length_m", "width_m", "height_m")
            new = np.array([change(list(row)) for row in np.stack([table[name] for name in names], -1)])
            table.update(zip(names, new.T, strict=True))

        change_feather(path / "annotations.feather", columns)
    elif layout == "nuscenes":

        def row(row: Any) -> Any:
            width, length, height = row["size"]
            length, width, height = change([length, width, height])
            return row | {"size": [width, length, height]}

        for file in path.rglob("sample_annotation.json"):
            change_json(file, lambda rows: [row(one) for one in rows])
    else:
        file = path / "tracklet_labels.xml"
        text = file.read_text()
        found = re.findall(r"<h>([^<]+)</h>\s*<w>([^<]+)</w>\s*<l>([^<]+)</l>", text)
        assert found
        for h, w, length in set(found):
            sides = change([float(length), float(w), float(h)])
            text = re.sub(
                rf"<h>{h}</h>(\s*)<w>{w}</w>(\s*)<l>{length}</l>",
                rf"<h>{sides[2]}</h>\1<w>{sides[1]}</w>\2<l>{sides[0]}</l>",
                text,
            )
        file.write_text(text)


@pytest.mark.parametrize("layout", FULL)
def test_boxes_in_millimetres_are_said(copied: Callable[[str], Path], layout: str) -> None:
    path = copied(layout)
    change_boxes(path, layout, lambda size: [1000 * side for side in size])
    said = info(path)
    assert re.search(
        r"longest edge of a box is \S+ m, not 0.05 to 150 m, as if it were given in|has the size .* m$", said
    ), said


@pytest.mark.parametrize("layout", FULL)
def test_length_and_width_exchanged_are_said(copied: Callable[[str], Path], layout: str) -> None:
    path = copied(layout)
    change_boxes(path, layout, lambda size: [size[1], size[0], size[2]])
    said = info(path)
    assert re.search(r"\d+% of \d+ vehicles' boxes are wider than long, as if swapped", said), said


def test_yaws_in_degrees_are_refused(copied: Callable[[str], Path]) -> None:
    path = copied("pandaset")
    for file in sorted((path / "annotations/cuboids").iterdir()):
        table = read_table(file)
        write_table(file, table | {"yaw": np.degrees(table["yaw"])})
    assert re.search(r"a cuboid's yaw is \S+, which is no angle in radians; degrees are not read", info(path))
    path = copied("kitti")
    text = (path / "tracklet_labels.xml").read_text()
    (path / "tracklet_labels.xml").write_text(re.sub(r"<rz>\S+</rz>", "<rz>-90.0</rz>", text))
    assert re.search(r"tracklet_labels.xml: .*rz is 90, which is no angle in radians", info(path))


@pytest.mark.parametrize("tracking", [False, True])
def test_kittis_angles_in_degrees_are_refused(copied: Callable[[str], Path], tmp_path: Path, tracking: bool) -> None:
    """Of the vehicle's and of a label's."""
    if tracking:
        label = "0 1 Car 0 0 -1.57 10 20 30 40 1.5 1.7 4.2 2.0 1.6 15.0"
        (tmp_path / "0000.txt").write_text(f"{label} 1.57\n{label.replace('0 1', '1 1', 1)} -90.0\n")
        with pytest.raises(LogError, match="0000.txt: a label's rotation_y is 90, which is no angle in radians"):
            read_labels(tmp_path / "0000.txt", np.eye(4))
        return
    path = copied("kitti")
    for file in (path / "oxts/data").iterdir():
        words = file.read_text().split()
        file.write_text(" ".join([*words[:5], "135.0", *words[6:]]))
    assert re.search(r"line 1: roll, pitch or yaw is 135, which is no angle in radians", info(path))


@pytest.mark.parametrize("layout", ["argoverse2", "pandaset", "kitti"])
def test_boxes_that_look_sideways_are_said(copied: Callable[[str], Path], layout: str) -> None:
    """Turned by a quarter about their z axis."""
    path = copied(layout)
    half = np.sqrt(0.5)
    if layout == "argoverse2":

        def columns(table: Table) -> None:
            w, x, y, z = (table[name].copy() for name in ("qw", "qx", "qy", "qz"))
            table.update(qw=half * (w - z), qx=half * (x + y), qy=half * (y - x), qz=half * (w + z))

        change_feather(path / "annotations.feather", columns)
    elif layout == "pandaset":
        for file in sorted((path / "annotations/cuboids").iterdir()):
            table = read_table(file)
            write_table(file, table | {"yaw": table["yaw"] + np.pi / 2})
    else:
        file = path / "tracklet_labels.xml"
        text = file.read_text()
        file.write_text(re.sub(r"<rz>([^<]+)</rz>", lambda at: f"<rz>{float(at[1]) + np.pi / 2}</rz>", text))
    assert re.search(r"where vehicles' boxes look and where they go is [89]\d(\.\d+)? degrees, not 0 to 45", info(path))


# what reads the log says it, too


def test_training_says_it(copied: Callable[[str], Path], tmp_path: Path) -> None:
    path = copied("kitti")
    change_sweeps(path, "kitti", lambda table: table.update(i=table["i"] * 255))
    arguments = ["train", str(path), "--out", str(tmp_path / "scene"), "--preset", "none", "--iterations", "1"]
    result = CliRunner().invoke(unisim, arguments)
    assert "they are taken as 0 to 255" in result.output


def test_info_as_json_has_them(copied: Callable[[str], Path]) -> None:
    path = copied("kitti")
    change_sweeps(path, "kitti", lambda table: table.update(i=table["i"] * 255))
    result = CliRunner().invoke(unisim, ["info", "--json", str(path)])
    (doubt,) = json.loads(result.output)["doubts"]
    assert doubt.startswith(str(path / "velodyne_points"))
