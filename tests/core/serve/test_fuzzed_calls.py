"""Calls of broken, mutated and random messages: each is answered, none fails inside, and another client is served all the while.

`make test-calls` makes 10 000 of them.
"""

from __future__ import annotations

import logging
import os
import random
import threading
from collections import Counter
from collections.abc import Iterator
from typing import Any

import grpc
import numpy as np
import pytest
from served_scenes import call, fault_of, served

from unisim_blender.core.formats.alpasim import messages
from unisim_blender.core.formats.alpasim.messages import camera_message, pose_message
from unisim_blender.core.serve.scenes import ServedScene

CALLS = int(os.environ.get("UNISIM_FUZZED_CALLS", "300"))
CLIENTS = 3
SIM = messages.sensorsim
NUMBERS = (0, 1, -1, 0.5, 1e-30, 1e30, -1e30, float("nan"), float("inf"), 1 << 31, 1 << 62, 64, 100_000)
WORDS = ("", "street", "front_camera", "pandar64", "car-01", "car-06", "\x00", "x" * 5000, "ä")
ANSWERS = {"OK", "INVALID_ARGUMENT", "NOT_FOUND", "RESOURCE_EXHAUSTED", "DEADLINE_EXCEEDED"}


def small_image(scene: ServedScene) -> Any:
    """A request of a small image."""
    camera = scene.drive.cameras["front_camera"]
    pose = pose_message(camera.world_from_camera.at(0.1))
    message = SIM.RGBRenderRequest(
        scene_id=scene.scene_id, resolution_w=16, resolution_h=9, frame_start_us=100_000, frame_end_us=130_000,
        camera_intrinsics=camera_message("front_camera", camera.model),
        sensor_pose=SIM.PosePair(start_pose=pose, end_pose=pose), image_format=SIM.ImageFormat.Value("PNG"),
    )  # fmt: skip
    place = np.eye(4)
    place[:3, 3] = [12.0, 0.0, 0.8]
    for uid in ("car-01", "car-06"):
        message.dynamic_objects.add(track_id=uid, pose_pair=SIM.PosePair(start_pose=pose_message(place), end_pose=pose))
    return message


def valid_calls(scene: ServedScene) -> list[tuple[str, Any]]:
    """Calls with requests that can be answered."""
    image = small_image(scene)
    scan = SIM.LidarRenderRequest(scene_id=scene.scene_id, frame_end_us=100_000, sensor_pose=image.sensor_pose)
    named = SIM.BatchRGBRenderRequestItem(camera_name="a", request=image)
    return [
        ("render_rgb", image),
        ("render_lidar", scan),
        ("batch_render_rgb", SIM.BatchRGBRenderRequest(items=[named, named])),
        ("render_aggregated", SIM.AggregatedRenderRequest(rgb_requests=[image])),
        ("get_available_cameras", SIM.AvailableCamerasRequest(scene_id=scene.scene_id)),
        ("get_available_trajectories", SIM.AvailableTrajectoriesRequest(scene_id=scene.scene_id)),
        ("get_version", messages.common.Empty()),
    ]


def mutated_bytes(data: bytes, draw: random.Random) -> bytes:
    """The bytes with some changed, cut out, doubled or put in; or others."""
    found = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 8))):
        at = draw.randrange(len(found) + 1)
        kind = draw.randrange(5)
        if kind == 0 and at < len(found):
            found[at] ^= 1 << draw.randrange(8)
        elif kind == 1:
            del found[at : at + draw.randrange(1, 20)]
        elif kind == 2:
            found[at:at] = draw.randbytes(draw.randrange(1, 20))
        elif kind == 3:
            found[at:at] = found[at : at + draw.randrange(1, 60)]
        else:
            found = bytearray(draw.randbytes(draw.randrange(60)))
    return bytes(found)


def mutate_field(message: Any, draw: random.Random) -> None:
    """Set a field, anywhere below a message, to an odd value of its type."""
    fields = message.DESCRIPTOR.fields
    if not fields:
        return
    field = draw.choice(list(fields))
    here = getattr(message, field.name)
    if field.message_type is not None:
        if field.is_repeated:
            if not len(here) or draw.random() < 0.1:
                here.add()
            here = draw.choice(list(here))
        elif draw.random() < 0.1:
            message.ClearField(field.name)
            return
        else:
            here.SetInParent()
        mutate_field(here, draw)
        return
    value: Any = draw.choice(WORDS if field.type in (field.TYPE_STRING, field.TYPE_BYTES) else NUMBERS)
    if field.type == field.TYPE_BYTES:
        value = str(value).encode()
    elif field.type == field.TYPE_BOOL:
        value = bool(draw.randrange(2))
    elif field.type not in (field.TYPE_STRING, field.TYPE_FLOAT, field.TYPE_DOUBLE):
        value = draw.randrange(-1, 9) if field.enum_type is not None else draw.choice((0, 1, 7, 4000, 1 << 31))
    try:
        if field.is_repeated:
            here.extend([value] * draw.choice((1, 3, 30)))
        else:
            setattr(message, field.name, value)
    except (ValueError, TypeError, OverflowError):
        pass  # this field does not take it


def fuzzed_calls(scene: ServedScene, seed: int, count: int) -> Iterator[tuple[str, bytes]]:
    """Calls, half of them with odd fields, the others with changed bytes."""
    draw, valid = random.Random(seed), valid_calls(scene)
    for _ in range(count):
        name, message = draw.choice(valid)
        if draw.random() < 0.5:
            yield (
                draw.choice(valid)[0] if draw.random() < 0.2 else name,
                mutated_bytes(message.SerializeToString(), draw),
            )
            continue
        odd = type(message).FromString(message.SerializeToString())
        for _ in range(draw.choice((1, 1, 2, 5))):
            mutate_field(odd, draw)
        yield name, odd.SerializeToString()


def test_every_call_is_answered(scenes: dict[str, ServedScene], caplog: pytest.LogCaptureFixture) -> None:
    (scene,) = scenes.values()
    statuses: Counter[str] = Counter()
    served_meanwhile, faults, done = [0], [], threading.Event()

    def attack(address: str, seed: int) -> None:
        with grpc.insecure_channel(address, [("grpc.use_local_subchannel_pool", 1)]) as channel:
            for name, data in fuzzed_calls(scene, seed, CALLS // CLIENTS):
                statuses[fault_of(channel, name, data, timeout=3.0)[0]] += 1

    def behave(address: str) -> None:
        with grpc.insecure_channel(address, [("grpc.use_local_subchannel_pool", 1)]) as channel:
            while not done.wait(0.05):
                for name, message in (("get_version", messages.common.Empty()), ("render_rgb", small_image(scene))):
                    try:
                        call(channel, name, message, timeout=60.0)
                    except grpc.RpcError as error:
                        faults.append((name, error.code(), error.details()))
                served_meanwhile[0] += 1

    with caplog.at_level(logging.WARNING), served(scenes) as address:
        attackers = [threading.Thread(target=attack, args=(address, seed)) for seed in range(CLIENTS)]
        other = threading.Thread(target=behave, args=(address,))
        for thread in (other, *attackers):
            thread.start()
        for thread in attackers:
            thread.join()
        done.set()
        other.join()
    assert not faults and served_meanwhile[0] > 2
    assert sum(statuses.values()) == CALLS // CLIENTS * CLIENTS and set(statuses) <= ANSWERS, statuses
    assert statuses["INVALID_ARGUMENT"] > CALLS // 5 and statuses["OK"] > CALLS // 20
    assert not [record for record in caplog.records if "serve" in record.name], caplog.text
