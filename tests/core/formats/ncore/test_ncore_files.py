"""NCore sequences that are broken, cut off, incomplete or hostile: one sentence that names the file, nothing run or written."""

from __future__ import annotations

import io
import json
import lzma
import pickle
import shutil
import struct
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from ncore_by_hand import START_US, SWEEP_US, write_by_hand

from unisim_blender.core.cli.main import unisim
from unisim_blender.core.errors import LogError, what_is_missing
from unisim_blender.core.formats.ncore import NcoreReader, components, stores_beside
from unisim_blender.core.formats.readers import open_log

ITAR, FOLDER = "clip.ncore4.zarr.itar", "clip.ncore4.zarr"
END_US = START_US + SWEEP_US - 1
SWEEP = f"lidars/roof/frames/{END_US}"


@pytest.fixture(scope="module")
def itar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("itar")
    write_by_hand(path)
    return path


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("directory")
    write_by_hand(path, store="directory")
    return path


def read_all(path: Path) -> None:
    """Open a log and read all that it has."""
    log = open_log(path)
    for camera in log.drive.cameras:
        log.own_vehicle_mask(camera)  # type: ignore[attr-defined]
        for frame in log.image_frames(camera):
            log.image(camera, frame)
    for lidar in log.drive.lidars:
        for frame in log.sweep_frames(lidar):
            log.sweep_grid(lidar, frame)


def refused(path: Path) -> str:
    """The sentence by which a log is refused."""
    with warnings.catch_warnings(), pytest.raises(LogError) as told:
        warnings.simplefilter("error")
        read_all(path)
    sentence = str(told.value)
    assert "\n" not in sentence and len(sentence) < 600, sentence
    return sentence


def copied(source: Path, to: Path) -> Path:
    shutil.copytree(source, to / "log")
    return to / "log"


def with_metadata(source: Path, to: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """A copy of a folder store whose description is changed."""
    folder = copied(source, to)
    paths = [path for path in (folder / FOLDER).rglob(".z*") if path.suffix != ".xz"]
    document = {path.relative_to(folder / FOLDER).as_posix(): json.loads(path.read_text()) for path in paths}
    change(document)
    for path in paths:
        name = path.relative_to(folder / FOLDER).as_posix()
        if name in document:
            path.write_text(json.dumps(document[name]))
        else:
            path.unlink()
    return folder


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.7, 0.95, 0.999])
def test_a_store_that_is_cut_off(share: float, itar: Path, tmp_path: Path) -> None:
    folder = copied(itar, tmp_path)
    store = folder / ITAR
    store.write_bytes(store.read_bytes()[: int(share * store.stat().st_size)])
    assert refused(folder) == f"{store}: is cut off or no store: it does not end with an index"


def test_a_store_whose_middle_is_missing(itar: Path, tmp_path: Path) -> None:
    """The index is there, and what it points to is not."""
    folder = copied(itar, tmp_path)
    store = folder / ITAR
    content = store.read_bytes()
    store.write_bytes(content[len(content) // 2 // 512 * 512 :])
    assert refused(folder).startswith(f"{store}: is cut off")


def test_random_bytes_in_a_store(itar: Path, tmp_path: Path) -> None:
    """Whatever bytes are changed: it is read, or one sentence names the store."""
    folder = copied(itar, tmp_path)
    store, rng, said = folder / ITAR, np.random.default_rng(5), 0
    content = store.read_bytes()
    for turn in range(60):
        broken = bytearray(content)
        begin = len(content) - 40_000 if turn % 2 else 0  # the index and the description lie at the end
        for at in rng.integers(max(begin, 0), len(content), 40):
            broken[at] = rng.integers(256)
        store.write_bytes(broken)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                read_all(folder)
        except LogError as error:
            said += 1
            assert str(folder) in str(error) and "\n" not in str(error)
    assert said > 25


def test_a_component_that_cannot_be_read(directory: Path, tmp_path: Path) -> None:
    folder = copied(directory, tmp_path)
    (folder / FOLDER / "poses/default/.zgroup").write_bytes(b"x")
    assert refused(folder).startswith(f"{folder / FOLDER}: poses/default cannot be read (")


def test_a_folder_that_lacks_a_part(directory: Path, tmp_path: Path) -> None:
    """zarr takes a part that is missing for one full of zeros."""
    parts = {
        f"{SWEEP}/ray_bundle/direction/0.0": f"roof: its sweep of {END_US} us, direction, lacks its part 0.0",
        f"{SWEEP}/ray_bundle_returns/intensity/0.0": f"roof: its sweep of {END_US} us, intensity, lacks its part 0.0",
        f"cameras/front/frames/{START_US + 43_000}/image/0": f"front: its image of {START_US + 43_000} us lacks its part 0",
    }
    for number, (part, sentence) in enumerate(parts.items()):
        (tmp_path / str(number)).mkdir()
        folder = copied(directory, tmp_path / str(number))
        (folder / FOLDER / part).unlink()
        assert refused(folder) == f"{folder / FOLDER}: {sentence}"


def test_a_folder_without_its_description(directory: Path, tmp_path: Path) -> None:
    folder = copied(directory, tmp_path)
    (folder / FOLDER / ".zgroup").unlink()
    assert refused(folder).startswith(f"{folder / FOLDER}: cannot be read (")


def test_a_store_that_the_document_lists_is_missing(tmp_path: Path) -> None:
    path = write_by_hand(tmp_path / "log", groups=True)
    store = tmp_path / "log" / "clip.ncore4-roof.zarr.itar"
    store.unlink()
    assert refused(path) == f"{store}: is missing; clip.json lists it"
    assert refused(tmp_path / "log") == f"{store}: is missing; clip.json lists it"
    path.unlink()
    read_all(tmp_path / "log")  # nothing says that there was a LiDAR


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("{", "is not valid JSON"),
        ("[]", "must be an object"),
        ('{"component_stores": 3}', "component_stores: must be an array"),
        ('{"component_stores": []}', "has no stores"),
        ('{"component_stores": [{"path": "../other/a.ncore4.zarr"}]}', "must be the name of a store beside the file"),
        ('{"component_stores": [{"path": "https://a.example/b.ncore4.zarr"}]}', "must be the name of a store"),
        ('{"component_stores": [{"path": "/etc/passwd"}]}', "must be the name of a store beside the file"),
    ],
)
def test_a_document_that_is_wrong(content: str, sentence: str, itar: Path, tmp_path: Path) -> None:
    path = copied(itar, tmp_path) / "clip.json"
    path.write_text(content)
    said = refused(path)
    assert said.startswith(str(path)) and sentence in said


def test_stores_of_two_sequences_in_a_folder(itar: Path, tmp_path: Path) -> None:
    folder = copied(itar, tmp_path)
    (folder / "clip.json").unlink()
    write_by_hand(tmp_path / "other", groups=True)
    shutil.copy(tmp_path / "other" / "clip.ncore4-roof.zarr.itar", folder / "a.ncore4-roof.zarr.itar")
    assert refused(folder) == f"{folder / ITAR}: holds 'roof', and so does a.ncore4-roof.zarr.itar"


def test_a_store_that_unpacks_without_end(itar: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(components, "MOST_BYTES", 1 << 20)
    bomb = lzma.compress(bytes((1 << 20) + 1), preset=0)
    folder = copied(itar, tmp_path)
    padded = bomb + bytes(-len(bomb) % 512)
    (folder / ITAR).write_bytes(padded + struct.pack("<4sIQI", b"itar", 1, 0, len(bomb)).ljust(512, b"\0"))
    assert refused(folder) == f"{folder / ITAR}: its index is broken or too large: it does not end within 1 MiB"


def test_nothing_is_unpickled(directory: Path, tmp_path: Path) -> None:
    """A zarr array may say that its parts are pickles; whoever reads it so runs what they say."""
    ran = tmp_path / "ran"

    class Hostile:
        def __reduce__(self) -> Any:
            return Path.touch, (ran,)

    name = f"{SWEEP}/ray_bundle/direction"
    hostile = pickle.dumps(Hostile())
    variants: list[dict[str, Any]] = [
        {"dtype": "|O", "filters": [{"id": "pickle", "protocol": 5}], "compressor": None, "fill_value": None},
        {"filters": [{"id": "pickle", "protocol": 5}], "compressor": None},
        {"compressor": {"id": "pickle", "protocol": 5}},
    ]
    for number, variant in enumerate(variants):
        (tmp_path / str(number)).mkdir()

        def change(metadata: dict[str, Any], variant: dict[str, Any] = variant) -> None:
            metadata[f"{name}/.zarray"].update(variant)

        folder = with_metadata(directory, tmp_path / str(number), change)
        (folder / FOLDER / name / "0.0").write_bytes(hostile)
        assert "which is refused" in (said := refused(folder)) or "in a way that is refused" in said
        assert not ran.exists()


def test_an_array_that_is_too_large(directory: Path, tmp_path: Path) -> None:
    name = f"{SWEEP}/ray_bundle/direction/.zarray"
    folder = with_metadata(directory, tmp_path, lambda meta: meta[name].update(shape=[10**9, 3], chunks=[10**9, 3]))
    assert "direction, is float32 (1000000000, 3), which is refused" in refused(folder)


METADATA: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "another version": (lambda meta: meta[".zattrs"].update(version="v9"), "incompatible data version v9"),
    "no id": (lambda meta: meta[".zattrs"].pop("sequence_id"), "cannot be read ('sequence_id')"),
    "no poses": (lambda meta: [meta.pop(key) for key in [*meta] if key.startswith("poses/")], "holds no poses"),
    "no rig": (
        lambda meta: meta["poses/default/dynamic_poses/.zattrs"].clear(),
        "no poses lead from 'rig' to 'world'",
    ),
    "a pose that is skew": (
        lambda meta: meta["poses/default/static_poses/.zattrs"]["('roof', 'rig')"]["pose"][0].__setitem__(0, 3.0),
        "the pose ('roof', 'rig'): is not rigid",
    ),
    "a pose that is no number": (
        lambda meta: meta["poses/default/static_poses/.zattrs"]["('roof', 'rig')"]["pose"][0].__setitem__(0, "x"),
        "its poses cannot be read",
    ),
    "a name that is code": (
        lambda meta: meta["poses/default/static_poses/.zattrs"].update(
            {"__import__('os').getcwd()": {"pose": np.eye(4).tolist(), "dtype": "float64"}}
        ),
        "its poses cannot be read",
    ),
    "times that go back": (
        lambda meta: meta["poses/default/dynamic_poses/.zattrs"]["('rig', 'world')"]["timestamps_us"].reverse(),
        "is not later than the one before",
    ),
    "a sensor that is nowhere": (
        lambda meta: meta["poses/default/static_poses/.zattrs"].pop("('roof', 'rig')"),
        "no poses lead from 'roof' to 'world'",
    ),
    "frames that go back": (
        lambda meta: meta["lidars/roof/frames/.zattrs"]["frames_timestamps_us"].reverse(),
        "roof: its frames' times do not increase",
    ),
    "a frame that is not there": (
        lambda meta: meta["lidars/roof/frames/.zattrs"]["frames_timestamps_us"].append(
            [END_US + 10**6, END_US + 2 * 10**6]
        ),
        f"roof: its sweep of {END_US + 2 * 10**6} us cannot be read",
    ),
    "no beam table": (
        lambda meta: meta["intrinsics/default/lidars/roof/.zattrs"]["lidar_model_parameters"].pop("row_elevations_rad"),
        "roof: its beam table cannot be read",
    ),
    "a beam table of nobody's": (
        lambda meta: meta["intrinsics/default/lidars/roof/.zattrs"].update(lidar_model_type="flash"),
        "roof: its beam table cannot be read (Unknown lidar model type: flash)",
    ),
    "a size below 0": (
        lambda meta: observation(meta)["bbox3"].update(dim=[4.0, -1.0, 2.0]),
        "cuboids[0].bbox3.dim: is the size [4.0, -1.0, 2.0] m",
    ),
    "a box that is nowhere": (
        lambda meta: observation(meta).update(reference_frame_id="moon"),
        "a cuboid is in the frame 'moon', of which there are no poses",
    ),
    "a box without a track": (lambda meta: observation(meta).pop("track_id"), 'cuboids[0]: "track_id" is missing'),
    "a box that is no number": (
        lambda meta: observation(meta)["bbox3"].update(centroid=[1.0, float("nan"), 2.0]),
        "cuboids[0].bbox3.centroid",
    ),
}


def observation(meta: dict[str, Any]) -> dict[str, Any]:
    first: dict[str, Any] = meta["cuboids/default/cuboids/.zattrs"]["cuboid_track_observations"][0]
    return first


@pytest.mark.parametrize("name", METADATA)
def test_descriptions_that_are_wrong(name: str, directory: Path, tmp_path: Path) -> None:
    change, sentence = METADATA[name]
    folder = with_metadata(directory, tmp_path, change)
    said = refused(folder)
    assert said.startswith(str(folder)) and sentence in said


def test_components_of_another_version_are_told(directory: Path, tmp_path: Path) -> None:
    """A newer NCore's are not read, and not passed over silently."""

    def newer(of: str) -> Callable[[dict[str, Any]], object]:
        return lambda meta: meta[f"{of}/.zattrs"].update(component_version="v9")

    (tmp_path / "camera").mkdir()
    log = open_log(with_metadata(directory, tmp_path / "camera", newer("cameras/front")))
    assert not log.drive.cameras and log.drive.lidars
    assert log.missing == ("cameras/front is left out: nvidia-ncore as installed does not read version 'v9'",)
    (tmp_path / "poses").mkdir()
    said = refused(with_metadata(directory, tmp_path / "poses", newer("poses/default")))
    assert "holds no poses (poses/default is left out: nvidia-ncore as installed" in said


def test_frames_that_have_no_poses_are_told(directory: Path, tmp_path: Path) -> None:
    def shorten(meta: dict[str, Any]) -> None:
        about = meta["poses/default/dynamic_poses/.zattrs"]["('rig', 'world')"]
        for key in ("poses", "timestamps_us"):
            about[key] = about[key][:11]  # the first tenth of a second of half a second

    log = open_log(with_metadata(directory, tmp_path, shorten))
    assert (
        "roof: there are no poses for 0.00 s at its beginning and 0.40 s at its end, where it goes on at its speed"
        in log.missing
    )


def test_an_image_of_a_global_shutter_is_taken_at_its_start(directory: Path, tmp_path: Path) -> None:
    """As NCore has it, also where the frame ends later."""

    def change(meta: dict[str, Any]) -> None:
        meta["intrinsics/default/cameras/front/.zattrs"]["camera_model_parameters"]["shutter_type"] = "GLOBAL"

    rolling, log = open_log(directory), open_log(with_metadata(directory, tmp_path, change))
    camera, before = log.drive.cameras["front"], rolling.drive.cameras["front"]
    assert camera.model.shutter.duration_s == 0 and before.model.shutter.duration_s > 0.02
    starts = [before.model_at(time_s).shutter.exposure_s(time_s)[0] for time_s in before.time_s.values()]
    np.testing.assert_allclose(sorted(camera.time_s.values()), sorted(starts), atol=1e-3)


def test_cuboids_of_other_names(directory: Path, tmp_path: Path) -> None:
    """Those of the name that NCore's loader takes come first; without them the only ones are read, and others are told."""
    folder = copied(directory, tmp_path)
    cuboids = folder / FOLDER / "cuboids"
    before = open_log(folder)
    shutil.copytree(cuboids / "default", cuboids / "refined")
    both = open_log(folder)
    assert both.drive.actors.keys() == before.drive.actors.keys()
    assert set(both.missing) == {*before.missing, "cuboids/refined is left out: 'default' is read"}
    shutil.rmtree(cuboids / "default")
    log = open_log(folder)
    assert log.drive.actors.keys() == before.drive.actors.keys() and log.missing == before.missing


def test_a_camera_that_cannot_be_modelled_is_left_out(directory: Path, tmp_path: Path) -> None:
    """The others' images and the LiDARs can still be used."""
    of = "intrinsics/default/cameras/front/.zattrs"
    windshield = {
        "external_distortion_type": "bivariate-windshield",
        "reference_poly": "FORWARD",
        **{f"{name}_poly{end}": [0.0, 1.0, 0.0] for name in ("horizontal", "vertical") for end in ("", "_inverse")},
    }
    changes: dict[str, Callable[[dict[str, Any]], object]] = {
        "stands behind a windshield of its own model": lambda meta: meta[of]["camera_model_parameters"].update(
            external_distortion_parameters=windshield
        ),
        "Unknown camera model type: periscope": lambda meta: meta[of].update(camera_model_type="periscope"),
        "fold or tear the image": lambda meta: meta[of]["camera_model_parameters"].update(
            radial_coeffs=[-1e9, 0, 0, 0, 0, 0]
        ),
    }
    for number, (sentence, change) in enumerate(changes.items()):
        (tmp_path / str(number)).mkdir()
        log = open_log(with_metadata(directory, tmp_path / str(number), change))
        assert not log.drive.cameras and len(log.drive.lidars) == 1
        (missing,) = log.missing
        assert missing.startswith("camera front is left out: ") and sentence in missing


@pytest.mark.parametrize(
    ("name", "change", "sentence"),
    [
        ("model_element", lambda x: x + np.uint16(50), "which the table lacks"),
        ("distance_m", lambda x: np.where(np.isfinite(x), np.float32(np.inf), x), ""),
    ],
)
def test_sweeps_that_are_wrong(name: str, change: Any, sentence: str, tmp_path: Path) -> None:
    folder = tmp_path / "log"
    write_by_hand(folder, **{name: change})
    if sentence:
        said = refused(folder)
        assert said.startswith(f"{folder / ITAR}: roof: its sweep of frame 0: ") and sentence in said
    else:  # an infinite distance is a ray without a return
        drops = open_log(folder).sweep("roof", 0).drops
        assert drops is not None and len(drops.time_s) == 180


@pytest.mark.parametrize(
    ("part", "values", "sentence"),
    [
        ("ray_bundle/direction", np.full((180, 3), 9, np.float32), "a ray's direction has not the length 1"),
        ("ray_bundle/direction", np.full((180, 3), np.nan, np.float32), "a ray's direction has not the length 1"),
        ("ray_bundle/timestamp_us", np.full(180, 2**60, np.uint64), "s from its sweep's time"),
        ("ray_bundle_returns/distance_m", np.full((1, 180), -1, np.float32), "a negative distance"),
        ("ray_bundle_returns/intensity", np.full((1, 180), np.nan, np.float32), "no intensity"),
    ],
)
def test_numbers_that_are_wrong(part: str, values: Any, sentence: str, directory: Path, tmp_path: Path) -> None:
    """NCore's writer asserts these; a file may hold anything."""
    name = f"{SWEEP}/{part}"
    folder = with_metadata(directory, tmp_path, lambda meta: meta[f"{name}/.zarray"].update(compressor=None))
    (chunk,) = [path for path in (folder / FOLDER / name).iterdir() if path.name[0] != "."]
    chunk.write_bytes(values.tobytes())
    said = refused(folder)
    assert said.startswith(f"{folder / FOLDER}: roof: its sweep of frame 0: ") and sentence in said


@pytest.mark.parametrize("content", [b"", b"no image", b"\x89PNG\r\n\x1a\n cut off"])
def test_images_that_are_none(content: bytes, directory: Path, tmp_path: Path) -> None:
    name = f"cameras/front/frames/{START_US + 43_000}/image"
    dtype = f"|S{max(len(content), 1)}"
    folder = with_metadata(directory, tmp_path, lambda meta: meta[f"{name}/.zarray"].update(dtype=dtype))
    (folder / FOLDER / name / "0").write_bytes(content)
    said = refused(folder)
    assert said.startswith(f"{folder / FOLDER}: front: its image of")
    assert said.endswith(("is no image", "is no PNG image")) or not content


def test_an_image_of_another_size(directory: Path, tmp_path: Path) -> None:
    from PIL import Image

    buffer = io.BytesIO()
    Image.new("RGB", (8, 8)).save(buffer, "PNG")
    name, content = f"cameras/front/frames/{START_US + 43_000}/image", buffer.getvalue()
    folder = with_metadata(directory, tmp_path, lambda m: m[f"{name}/.zarray"].update(dtype=f"|S{len(content)}"))
    (folder / FOLDER / name / "0").write_bytes(content)
    assert "has 8x8 pixels, the camera 40x24" in refused(folder)


def test_the_command_line_says_the_sentence(itar: Path, tmp_path: Path) -> None:
    folder = copied(itar, tmp_path)
    (folder / ITAR).write_bytes(b"nothing")
    told = CliRunner().invoke(unisim, ["info", str(folder)])
    assert told.exit_code == 1 and isinstance(told.exception, LogError)
    assert str(told.exception).startswith(f"{folder / ITAR}: is cut off or no store")


def test_without_the_package_a_sentence_says_what_to_install(itar: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "ncore" or ".formats.ncore." in name]:
        monkeypatch.delitem(sys.modules, name)
    for name in ("ncore", "ncore.data", "ncore.data.v4"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ModuleNotFoundError) as told:
        open_log(itar)
    assert what_is_missing(told.value).endswith("pip install '.[ncore]' in the folder of unisim_blender's sources")


def test_what_is_a_sequence(itar: Path, tmp_path: Path) -> None:
    reader = NcoreReader()
    assert reader.recognises(itar) and reader.recognises(itar / ITAR) and reader.recognises(itar / "clip.json")
    (tmp_path / "clip.json").write_text(json.dumps({"component_stores": []}))
    (tmp_path / "a.zarr").mkdir()
    for path in (
        tmp_path,
        tmp_path / "clip.json",
        tmp_path / "a.zarr",
        tmp_path / "none.ncore4.zarr",
        itar / "none.json",
    ):
        assert not reader.recognises(path)
    assert stores_beside(itar) == [itar / ITAR]
