"""The detection benchmark's samples, targets and training: its data code, not how well it detects."""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[3]))

from small_log import CAMERA, small_drive, write_small_log

from benchmarks.detection import camera, lidar
from benchmarks.detection import simulated as simulated_module
from benchmarks.detection import weather as weather_module
from benchmarks.detection.camera import CameraDetector
from benchmarks.detection.detector import Detector, decode, loss
from benchmarks.detection.lidar import LidarDetector
from benchmarks.detection.samples import (
    VEHICLES,
    Key,
    Sample,
    image_box,
    read_set,
    sample_from_log,
    write_set,
)
from benchmarks.detection.simulated import SimulatedSet
from benchmarks.detection.streets import StreetSet, varied
from benchmarks.detection.testing import common, detect, gaps, labels, trained_on
from benchmarks.detection.training import WEIGHTS, load_detector, train
from benchmarks.detection.truth import TrueSet
from benchmarks.detection.weather import plot, recalls
from unisim_blender.core.errors import LogError, OutputError, SceneError, UnisimError
from unisim_blender.core.evaluation.autonomy.document import FrameKey, FrameOutput, ModelOutputs, bev_iou, image_iou
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_yaw, transform_points
from unisim_street.street import build_street
from unisim_street.write import write_log

CARS = np.array(
    [
        [12.3, 1.7, 4.6, 2.0, 0.1],
        [12.9, -1.6, 4.1, 1.9, 3.1],
        [33.4, 4.4, 7.9, 2.5, -1.4],
        [70.2, -20.1, 5.2, 2.1, 1.55],
    ],
    np.float32,
)
IN_IMAGE = np.array([[0, 60, 70, 170], [40, 70, 90, 110], [200, 80, 213, 91], [150, 75, 230, 140]], np.float32)


def some_sample(seed: int = 0) -> Sample:
    """Four cars with returns on their outlines, among returns of nothing."""
    rng = np.random.default_rng(seed)
    points = [rng.uniform([0, -40, -0.1, 0], [80, 40, 0.1, 1], (500, 4))]
    for x, y, length, width, yaw in CARS:
        local = rng.uniform(-0.5, 0.5, (60, 2)) * [length, width]
        c, s = np.cos(yaw), np.sin(yaw)
        points.append(
            np.column_stack([local @ [[c, s], [-s, c]] + [x, y], rng.uniform(0.3, 1.5, 60), rng.uniform(0, 1, 60)])
        )
    image = rng.integers(0, 255, (180, 320, 3), np.uint8)
    hits = np.full(len(CARS), 60, np.int32)
    return Sample(
        image, np.concatenate(points).astype(np.float32), CARS, hits, IN_IMAGE, np.ones(len(CARS), np.float32)
    )


def maps_of(classes: NDArray[np.int8], regression: NDArray[np.float32]) -> NDArray[np.float32]:
    """What a network would give that has learnt its targets."""
    return np.concatenate([np.where(classes == 1, 8.0, -8.0)[None], regression]).astype(np.float32)


def modulo_half_turn(boxes: FloatArray) -> FloatArray:
    out = boxes.copy()
    out[:, 4] = (out[:, 4] + np.pi / 2) % np.pi - np.pi / 2
    return out


@pytest.mark.parametrize("detector", [LidarDetector(), CameraDetector()], ids=["lidar", "camera"])
def test_encoded_boxes_decode_to_themselves(detector: Detector) -> None:
    example = detector.example(some_sample(), None)
    found, scores = decode(detector, maps_of(example.classes, example.regression))
    expected = CARS if detector.kind == "bev" else IN_IMAGE
    assert len(found) == len(expected) and (scores > 0.99).all()
    iou = (bev_iou if detector.kind == "bev" else image_iou)(expected.astype(np.float64), found)
    found = found[iou.argmax(1)]
    if detector.kind == "bev":
        found, expected = modulo_half_turn(found), modulo_half_turn(expected.astype(np.float64)).astype(np.float32)
    # distances to sides below a pixel are kept as one
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_every_counted_box_has_a_cell_of_its_own() -> None:
    tiny = np.array([[20.4, 3.6, 0.8, 0.6, 0.3]], np.float32)
    classes, _ = lidar.encode(tiny, np.zeros(1, bool), 80, 80, -40.0)
    assert (classes == 1).sum() >= 1 and classes[20, 43] == 1
    classes, _ = camera.encode(np.array([[101, 81, 103, 83]], np.float32), np.zeros(1, bool), 45, 80)
    assert (classes == 1).sum() == 1 and classes[20, 25] == 1


def test_cells_of_ignored_boxes_do_not_count() -> None:
    classes, _ = lidar.encode(CARS, np.array([True, False, False, False]), 80, 80, -40.0)
    assert classes[12, 41] == -1 and classes[12, 38] == 1 and classes[60, 60] == 0
    classes, _ = camera.encode(IN_IMAGE, np.array([False, False, False, True]), 45, 80)
    assert classes[27, 47] == -1 and classes[22, 16] == 1 and classes[1, 1] == 0


def test_the_nearer_of_two_vehicles_has_the_cells_they_share() -> None:
    boxes = np.array([[0, 0, 80, 80], [30, 30, 50, 50]], np.float32)
    rows, columns = np.array([10]), np.array([10])
    for distances, expected in (((9, 30), [0, 0, 80, 80]), ((30, 9), [30, 30, 50, 50])):
        bev = np.array([[distance, 0, 4, 2, 0] for distance in distances], np.float32)
        two = np.ones(2, np.float32)
        sample = dataclasses.replace(some_sample(), bev=bev, boxes=boxes, hits=np.full(2, 9, np.int32), inside=two)
        example = CameraDetector().example(sample, None)
        assert camera.decode_boxes(example.regression, rows, columns)[0] == pytest.approx(expected, abs=1e-3)


def test_what_nearer_vehicles_hide_is_ignored() -> None:
    # the second is nearest, the third a quarter behind it, the first all behind the third
    boxes = np.array([[100, 60, 120, 80], [0, 60, 80, 100], [60, 60, 140, 80]], np.float32)
    bev = np.array([[30, 0, 4, 2, 0], [8, 0, 4, 2, 0], [20, 0, 4, 2, 0]], np.float32)
    ones = np.ones(3, np.float32)
    sample = dataclasses.replace(some_sample(), bev=bev, boxes=boxes, hits=np.full(3, 9, np.int32), inside=ones)
    assert sample.nearest_first.tolist() == [1, 2, 0]
    assert sample.hidden == pytest.approx([1.0, 0.0, 0.25])
    assert sample.boxes_ignored.tolist() == [True, False, False]
    assert dataclasses.replace(sample, hits=np.array([9, 4, 9], np.int32)).boxes_ignored.tolist() == [True, True, False]


def test_raster_of_three_points() -> None:
    points = np.array([[10.1, 0.1, 0.3, 0.2], [10.2, 0.2, 0.5, 0.7], [10.1, 0.1, 7.0, 1.0]], np.float32)
    image = lidar.raster(points, (-16.0, 16.0))
    row, column = 40, 64
    assert image.shape == (lidar.CHANNELS, 320, 128)
    assert image[:-2, row, column].tolist() == [0, 1, 0, 0, 0, 0, 0, 0]
    assert image[-2, row, column] == np.float32(0.7) and image[-1, row, column] == pytest.approx(np.log(3) / 4)
    assert np.count_nonzero(image) == 3


def test_points_stay_on_their_cars_when_a_sweep_is_varied() -> None:
    sample = some_sample()
    points, boxes = lidar.varied(sample.points, sample.bev, np.random.default_rng(1))
    assert np.abs(boxes - sample.bev).max() > 0.1
    for before, after in zip(sample.bev, boxes, strict=True):
        assert (inside(points, after) == inside(sample.points, before)).mean() > 0.999 and inside(
            points, after
        ).sum() >= 60


def inside(points: NDArray[np.float32], box: NDArray[np.float32]) -> NDArray[np.bool_]:
    offset = points[:, :2] - box[:2]
    c, s = np.cos(box[4]), np.sin(box[4])
    local = offset @ np.array([[c, -s], [s, c]])
    return np.asarray((np.abs(local) <= box[2:4] / 2 + 1e-4).all(-1))


def test_boxes_stay_on_their_pixels_when_an_image_is_varied() -> None:
    image = np.zeros((180, 320, 3), np.uint8)
    left, top, right, bottom = 100, 60, 180, 120
    image[top:bottom, left:right] = 255
    box = np.array([[left, top, right, bottom]], np.float32)
    sample = dataclasses.replace(some_sample(), image=image, boxes=box, inside=np.ones(1, np.float32))
    changed, boxes, share = camera.cropped(sample, np.random.default_rng(2))
    changed, boxes = camera.mirrored(changed, boxes)
    rows, columns = np.nonzero(changed[..., 0] > 127)
    assert boxes[0] == pytest.approx([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1], abs=1.0)
    assert np.abs(boxes - box).max() > 5 and share[0] == 1.0


def test_a_projected_box_holds_what_is_in_it() -> None:
    drive = small_drive()
    actor, view = drive.actors["car-1"], drive.cameras["front_camera"]
    box, share = image_box(actor, view, 0)
    time = view.time_s[0]
    inner = np.random.default_rng(0).uniform(-0.5, 0.5, (500, 3)) * actor.size_m
    world = transform_points(actor.world_from_actor.at(time), inner)
    local = transform_points(np.linalg.inv(view.world_from_camera.at(time)), world)
    u, v = CAMERA.fx * local[:, 0] / local[:, 2] + CAMERA.cx, CAMERA.fy * local[:, 1] / local[:, 2] + CAMERA.cy
    assert 0 < share <= 1
    assert u.min() > box[0] - 0.5 and v.min() > box[1] - 0.5 and u.max() < box[2] + 0.5 and v.max() < box[3] + 0.5
    assert u.max() - u.min() > 0.8 * (box[2] - box[0]) and v.max() - v.min() > 0.8 * (box[3] - box[1])


def test_what_is_behind_the_camera_has_no_box() -> None:
    drive = small_drive()
    behind = Trajectory(np.zeros(1), np.array([[-30.0, 0, 0]]), quaternion_from_yaw(np.zeros(1)))
    actor = dataclasses.replace(drive.actors["van"], world_from_actor=behind)
    assert image_box(actor, drive.cameras["front_camera"], 0) == ((0.0, 0.0, 0.0, 0.0), 0.0)
    # one that the camera is in fills the image
    here = drive.cameras["front_camera"].world_from_camera.at(drive.cameras["front_camera"].time_s[0])
    around = Trajectory(np.zeros(1), here[None, :3, 3], quaternion_from_yaw(np.zeros(1)))
    box, _ = image_box(dataclasses.replace(actor, world_from_actor=around), drive.cameras["front_camera"], 0)
    assert box == (0.0, 0.0, 48.0, 32.0)


def test_a_logs_samples_are_in_the_ego_frame(tmp_path: Path) -> None:
    drive = write_small_log(tmp_path / "log")
    log = open_log(tmp_path / "log")
    sample = sample_from_log(log, "front_camera", "pandar64", 1)
    assert sample.image.shape == (213, 320, 3)
    # the van is a vehicle that stands still, the cone is none
    world_from_ego = drive.world_from_ego.at(drive.time_s[1])
    van = np.linalg.inv(world_from_ego) @ make_pose(np.array([8.0, -4.0, 0.9]), quaternion_from_yaw(-1.1))
    assert len(sample.bev) == 2
    row = sample.bev[np.abs(sample.bev[:, 2] - 5.5).argmin()]
    assert row == pytest.approx([van[0, 3], van[1, 3], 5.5, 2.1, np.arctan2(van[1, 0], van[0, 0])], abs=1e-3)


def test_a_set_is_completed_and_not_overwritten(tmp_path: Path) -> None:
    made: list[Key] = []

    def make(key: Key) -> Sample:
        made.append(key)
        return some_sample(key.frame)

    keys = [Key("street-1", 0), Key("street-1", 8)]
    write_set(tmp_path / "set", {"seeds": (1,)}, keys[:1], make)
    write_set(tmp_path / "set", {"seeds": (1,)}, keys, make)
    assert made == keys
    found = read_set(tmp_path / "set")
    assert list(found) == keys
    assert (found[keys[1]].points == some_sample(8).points).all() and (
        found[keys[0]].image == some_sample(0).image
    ).all()
    with pytest.raises(OutputError, match="another set"):
        write_set(tmp_path / "set", {"seeds": (2,)}, keys, make)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").touch()
    with pytest.raises(OutputError, match="holds no set"):
        write_set(tmp_path / "other", {}, keys, make)
    with pytest.raises(LogError, match="holds no samples"):
        read_set(tmp_path / "other")


def test_varied_streets_have_their_traffic_elsewhere() -> None:
    drive = build_street(5, 4, 32, 18).drive
    moving = {actor.uid for actor in drive.actors.values() if actor.is_moving}
    edits = varied(drive, 5)
    assert edits == varied(drive, 5) and edits != varied(drive, 6) and len(edits) == len(moving) + 1
    assert StreetSet((5, 6), 20, 8, True).keys == [
        Key(f"street-{seed}", frame) for seed in (5, 6) for frame in (0, 8, 16)
    ]


def test_a_streets_sample_has_returns_on_its_cars() -> None:
    sample = StreetSet((3,), 2, 1, False, width=64, height=36).sample(Key("street-3", 0))
    near = (sample.bev[:, 0] > 5) & (sample.bev[:, 0] < 25)
    assert near.sum() >= 3 and (sample.hits[near] > 100).all()
    # the car ahead, 16 m before the vehicle in its lane, is in the image's middle
    ahead = np.flatnonzero((np.abs(sample.bev[:, 1]) < 0.5) & near)
    assert len(ahead) == 1 and sample.inside[ahead[0]] == 1
    left, top, right, bottom = sample.boxes[ahead[0]]
    assert 150 < (left + right) / 2 < 180 and 80 < (top + bottom) / 2 < 130
    # its label is where the returns are: all of those above the ground that are near are in the box
    near_it = (np.abs(sample.points[:, :2] - sample.bev[ahead[0], :2]) < [3.5, 1.5]).all(-1)
    points = sample.points[near_it & (sample.points[:, 2] > 0.3)]
    assert len(points) > 100 and inside(points, sample.bev[ahead[0]] + [0, 0, 0.1, 0.1, 0]).mean() > 0.99


@pytest.mark.slow
def test_a_simulated_sample_is_of_the_same_edited_street(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    streets, key = StreetSet((3,), 4, 3, True, width=64, height=36), Key("street-3", 3)
    simulated = SimulatedSet(streets, tmp_path, 2, "tiny")
    sample, exact = simulated.sample(key), streets.sample(key)
    recorded = dataclasses.replace(streets, varied=False).sample(key)
    assert sample.image.shape == exact.image.shape and sample.points.shape[1] == 4
    # two steps move no box by a centimetre; where a sweep passes one hangs on returns, which have not settled
    assert np.abs(sample.bev - exact.bev).max() < 0.5 < np.abs(exact.bev - recorded.bev).max()
    scene = tmp_path / "street-3" / "scene-tiny-2"
    assert json.loads((scene / "scene.json").read_text())["training"]["frames"] == [1, 2]
    # another process renders what is learnt
    monkeypatch.setattr("unisim_blender.core.training.loop.train", None)
    simulated_module._renderer.cache_clear()
    again = simulated.sample(key)
    assert (again.image == sample.image).all() and (again.points == sample.points).all()
    with pytest.raises(SceneError, match=r"was trained with frames \[1, 2\], not \[1, 3\]"):
        SimulatedSet(dataclasses.replace(streets, step=2), tmp_path, 2, "tiny").sample(key)


def test_a_true_sample_is_the_exact_streets(tmp_path: Path) -> None:
    streets = StreetSet((3,), 4, 3, False, left_m=2.0, width=64, height=36)
    write_log(streets.street(3), tmp_path / "log", 1, progress=False)
    edit = {"type": "ego", "shift_left_m": 2.0}
    document = {"format": "unisim-scenario", "version": 1, "name": "left", "log": "log", "edits": [edit]}
    (tmp_path / "left.json").write_text(json.dumps(document))
    true = TrueSet(tmp_path / "left.json", "::3")
    assert [key.frame for key in true.keys] == [0, 3]
    sample, exact = true.sample(true.keys[1]), streets.sample(Key("street-3", 3))
    assert (sample.image == exact.image).all() and np.abs(sample.bev - exact.bev).max() < 1e-3
    assert len(sample.points) == len(exact.points) and np.abs(sample.points - exact.points).max() < 2e-3


def test_labels_name_pandasets_vehicles() -> None:
    assert {"Car", "Pickup Truck", "Medium-sized Truck"} < set(VEHICLES) and "Cones" not in VEHICLES


def test_loss_counts_cells_and_vehicles() -> None:
    maps = torch.zeros(1, 3, 1, 3)
    classes = torch.tensor([[[1, 0, -1]]])
    regression = torch.zeros(1, 2, 1, 3)
    regression[0, :, 0, 0] = torch.tensor([1.05, -0.05])
    regression[0, :, 0, 1] = 9.0
    focal, away = loss(maps, classes, regression)
    # at probability 1/2 each: (1/4 + 3/4) (1/2)^2 log 2; what does not count gives nothing
    assert float(focal) == pytest.approx(0.25 * np.log(2))
    # smooth L1 with beta 0.1: 1.05 - 0.05, and 0.05^2 / 0.2
    assert float(away) == pytest.approx(1.0 + 0.0125)


def small_set(path: Path) -> Path:
    write_set(
        path,
        {"seeds": [0, 1]},
        [Key("street-0", 0), Key("street-1", 0)],
        lambda key: some_sample(int(key.sequence[-1])),
    )
    return path


def test_an_interrupted_training_goes_on_to_the_same_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    data = small_set(tmp_path / "set")
    monkeypatch.setattr("benchmarks.detection.training._KEPT_EVERY", 2)
    train("camera", [data], tmp_path / "whole", 4, 2, seed=3)
    from benchmarks.detection.training import Trainer

    advance = Trainer.advance

    def killed(self: Trainer) -> tuple[float, float]:
        if self.step == 3:
            raise KeyboardInterrupt
        return advance(self)

    monkeypatch.setattr(Trainer, "advance", killed)
    with pytest.raises(KeyboardInterrupt):
        train("camera", [data], tmp_path / "parts", 4, 2, seed=3)
    with pytest.raises(UnisimError, match="has not finished"):
        load_detector(tmp_path / "parts")
    monkeypatch.setattr(Trainer, "advance", advance)
    train("camera", [data], tmp_path / "parts", 4, 2, seed=3)
    assert (tmp_path / "parts" / WEIGHTS).read_bytes() == (tmp_path / "whole" / WEIGHTS).read_bytes()
    with pytest.raises(OutputError, match="other settings"):
        train("camera", [data], tmp_path / "parts", 4, 2, seed=4)
    torch.set_num_threads(threads)


def test_gaps_of_frames_with_themselves_are_none(tmp_path: Path) -> None:
    data = small_set(tmp_path / "set")
    train("lidar", [data], tmp_path / "lidar", 2, 1, seed=0)
    trained, samples = load_detector(tmp_path / "lidar"), read_set(data)
    metrics = gaps(trained, trained, samples, samples, resamples=20)
    assert metrics["real"]["labels"] == 8 and metrics["lost"]["sim2real"]["map"] == {
        "value": 0.0,
        "interval": [0.0, 0.0],
    }
    assert metrics["frames"] == metrics["resampled"] == 2
    truth = labels(trained.detector, samples)
    assert list(truth.frames) == list(detect(trained, samples).frames) == [("street-0", 0), ("street-1", 0)]
    assert trained_on(trained, samples) == ["street-0", "street-1"]
    assert trained_on(trained, {Key("street-9", 0): some_sample(), Key("street-1", 5): some_sample()}) == ["street-1"]
    with pytest.raises(UnisimError, match="share no frame"):
        common(samples, {Key("street-9", 0): some_sample()})


def test_recall_in_fog_counts_labels_of_clear_air_at_one_score(tmp_path: Path) -> None:
    """An exact detector in place of a trained network; in fog it is shown one of four cars, and one that is not there."""
    data = small_set(tmp_path / "set")
    train("lidar", [data], tmp_path / "lidar", 2, 1, seed=0)
    trained, clear = load_detector(tmp_path / "lidar"), read_set(data)
    shown = {id(sample): sample.bev for sample in clear.values()}
    foggy = {}
    for key, sample in clear.items():
        foggy[key] = dataclasses.replace(sample, points=sample.points[:0], bev=sample.bev[:1])
        shown[id(foggy[key])] = np.concatenate(
            [sample.bev[:1], sample.bev[1:2] + np.array([20, 20, 0, 0, 0], np.float32)]
        )

    def exact(trained: object, samples: dict[Key, Sample]) -> ModelOutputs:
        frames: dict[FrameKey, FrameOutput] = {}
        for key, sample in samples.items():
            boxes = shown[id(sample)].astype(np.float64)
            none = np.zeros(len(boxes), bool)
            frames[key.sequence, key.frame] = FrameOutput(
                boxes, np.full(len(boxes), 0.8), ("vehicle",) * len(boxes), none
            )
        return ModelOutputs(LidarDetector().kind, frames)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(weather_module, "detect", exact)
        result = recalls(trained, {None: clear, 50.0: foggy})
    assert result["least_score"] == 0.8 and result["labels"] == 8
    assert [(row["recall"], row["precision"]) for row in result["rows"]] == [(1.0, 1.0), (0.25, 0.5)]
    plot({"lidar": result}, tmp_path / "recall.png")
    assert (tmp_path / "recall.png").read_bytes()[:4] == b"\x89PNG"


def test_every_command_takes_its_options_and_finds_its_modules() -> None:
    from benchmarks.detection import __main__ as commands

    folder = Path(commands.__file__).parent
    modules = re.findall(r"from \.(\w+) import", Path(commands.__file__).read_text())
    assert modules and [name for name in modules if not (folder / f"{name}.py").is_file()] == []
    for command in commands.main.commands.values():
        assert command.callback is not None
        options = dict.fromkeys(parameter.name or "" for parameter in command.params)
        inspect.signature(command.callback, follow_wrapped=False).bind(**options)
