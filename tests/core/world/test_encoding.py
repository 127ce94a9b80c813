"""States and sensors as text: nothing is lost on the way, and what is no such text is one sentence."""

from __future__ import annotations

import base64
from dataclasses import asdict, replace

import numpy as np
import pytest
from busy_drive import busy_drive
from tiny_drive import tiny_drive

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.sensors.rays import exposure_window
from unisim_blender.core.world.drive import Box, Camera, Drive, Lidar, StaticCopy
from unisim_blender.core.world.encoding import decode_sensor, decode_state, encode_sensor, encode_state
from unisim_blender.core.world.replay import DriveStates, WorldState


@pytest.fixture(scope="module")
def busy(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    return busy_drive(tmp_path_factory.mktemp("busy"))


def with_statics(drive: Drive) -> Drive:
    box = Box(np.eye(4), np.array([1.0, 2.0, 3.0]))
    return replace(drive, static_copies=(StaticCopy('a"b\n', box, 2 * np.eye(4)),), static_removals=(box, box))


def states(busy: Drive) -> list[WorldState]:
    found = [
        DriveStates(drive, {}) for drive in (busy, tiny_drive(), with_statics(tiny_drive()), replace(busy, actors={}))
    ]
    return [one.state(*window) for one in found for window in ((0.0, 0.0), (0.05, 0.15), (-1.0, 2.0), (7.0, 7.5))]


def test_a_state_that_is_decoded_is_the_state(busy: Drive) -> None:
    for state in states(busy):
        text = encode_state(state)
        again = decode_state(text)
        assert again.digest == state.digest and encode_state(again) == text
        # a digest may leave something out
        assert [replace(a, size_m=0, world_from_actor=0) for a in again.actors] == [  # type: ignore[arg-type]
            replace(a, size_m=0, world_from_actor=0)  # type: ignore[arg-type]
            for a in state.actors
        ]


def test_a_sensor_that_is_decoded_is_the_sensor(busy: Drive) -> None:
    for drive in (busy, tiny_drive()):
        for camera in drive.cameras.values():
            window = exposure_window(camera, 0.1)
            again = decode_sensor(encode_sensor(camera.resized(17), *window))
            assert isinstance(again, Camera)
            for time_s in (*window, 0.1):
                np.testing.assert_array_equal(again.world_from_camera.at(time_s), camera.world_from_camera.at(time_s))
            kept = replace(again, world_from_camera=camera.world_from_camera, time_s=camera.time_s)
            assert kept == camera.resized(17)
        for lidar in drive.lidars.values():
            blocked = np.random.default_rng(0).random((lidar.model.beams, lidar.model.columns)) < 0.1
            for one in (lidar, replace(lidar, blocked=blocked, sees_ego_body=True)):
                window = exposure_window(one, 0.1)
                read = decode_sensor(encode_sensor(one, *window))
                assert isinstance(read, Lidar)
                np.testing.assert_array_equal(read.world_from_lidar.at(0.07), one.world_from_lidar.at(0.07))
                assert read.sees_ego_body == one.sees_ego_body and read.sensor_id == one.sensor_id
                assert (read.blocked is None) == (one.blocked is None)
                if one.blocked is not None and read.blocked is not None:
                    np.testing.assert_array_equal(read.blocked, one.blocked)
                a, b = asdict(read.model), asdict(one.model)
                assert all(np.array_equal(a[name], b[name]) for name in b) and a.keys() == b.keys()


def test_it_is_small(busy: Drive) -> None:
    state = DriveStates(busy, {}).state(0.05, 0.15)
    assert len(encode_state(state)) < 1000 * (1 + len(state.actors) + len(state.removed_boxes))


def test_what_is_no_state_is_one_sentence(busy: Drive) -> None:
    text = encode_state(DriveStates(busy, {}).state(0.0, 0.1))
    data, rng = base64.b64decode(text), np.random.default_rng(0)
    sensor = encode_sensor(tiny_drive().cameras["front"], 0.0, 0.1)
    later = base64.b64encode(data[:3] + b"\x63" + data[4:]).decode()
    wrong = ["", "x", "ä", sensor, text[:-8], base64.b64encode(b"UWS").decode(), later]
    for _ in range(300):
        broken = bytearray(data)
        for at in rng.integers(0, len(data), rng.integers(1, 4)):
            broken[at] ^= int(rng.integers(1, 256))
        wrong.append(base64.b64encode(bytes(broken)).decode())
    for one in wrong:
        with pytest.raises(UnisimError) as caught:
            decode_state(one)
        assert "that was sent" in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(UnisimError, match="has version 99"):
        decode_state(later)
    with pytest.raises(UnisimError, match="of another kind"):
        decode_sensor(text)


def test_a_whole_text_with_a_wrong_content_is_one_sentence() -> None:
    """As a program of another version might make it: the digest agrees, the content does not."""
    from unisim_blender.core.world.encoding import _packed

    header = {"kind": "state", "ego_keys": 1, "actors": [], "static_copies": [], "removed_boxes": 0}
    numbers = [np.zeros(2), np.zeros(1), np.zeros(3), np.array([1.0, 0, 0, 0])]
    assert decode_state(_packed(header, numbers)).actors == ()
    for changed, values in (
        ({**header, "ego_keys": -1}, numbers),
        ({**header, "ego_keys": "one"}, numbers),
        ({**header, "actors": [["a"]]}, numbers),
        ({**header, "actors": 3}, numbers),
        ({"kind": "state"}, numbers),
        (header, [*numbers, np.zeros(1)]),
        (header, [np.full(2, np.nan), *numbers[1:]]),
        (header, [*numbers[:3], np.zeros(4)]),
        ({**header, "removed_boxes": 10**9}, numbers),
    ):
        with pytest.raises(UnisimError, match="that was sent"):
            decode_state(_packed(changed, values))
