"""The finished folder of a sequence or of a rollout, read as messages in the order of time, one after another."""

from __future__ import annotations

import heapq
import json
import math
from collections.abc import Iterator, Mapping
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import OutputError, short
from ..formats.common.messages import (
    POINT_FIELDS,
    SECOND_NS,
    BoxLabels,
    ImageMessage,
    LabelledBox,
    Message,
    Mounts,
    PlannedPoses,
    Pose,
    RolloutEgo,
    SweepMessage,
)
from ..formats.rendered import camera_path, labels_path, lidar_path, read_rendered, sweep_arrays
from ..geometry import (
    STEADY_M,
    STEADY_RAD,
    FloatArray,
    invert_pose,
    mean_pose,
    quaternion_from_matrix,
    quaternion_from_yaw,
)
from ..json_file import Node, read_json
from ..simulation.rollout.steps import RolloutStep, stream_steps
from ..simulation.vehicle.actions import Plan
from ..world.captures import US_PER_SECOND
from ..world.drive import EGO

LABELS, CAMERA, LIDAR = "labels", "camera", "lidar"
KINDS = (LABELS, CAMERA, LIDAR)
"""In the order of messages of one time: first where everything is."""
STATIC_COPY = "static copy"
"""Class of a copied part of the background."""
MOST_LABELS = 16
"""Moments whose labels are kept: captures of neighbouring moments may alternate."""


class _Entry(NamedTuple):
    """A file of a run, in the order of time; ``rank`` is its kind's place in `KINDS`."""

    time_ns: int
    rank: int
    sensor_id: str
    moment: str


class FinishedRun:
    """A folder that `unisim render` or `unisim drive` finished.

    ``drive``: what was rendered, its cameras at the size of the images. ``instances``: the names that points' instances count in,
    from 1. ``images``: what images are called in files that name them, by their paths below the folder, which are their names
    otherwise. ``shift_ns``: what is added to times, whole seconds, so that none is below 0; 0 where none is. Raises `LogError`.
    """

    def __init__(self, path: Path, images: Mapping[str, str] | None = None) -> None:
        self.path = path
        self._images = images or {}
        manifest, self.drive = read_rendered(path)
        copies = (copy.uid for copy in self.drive.static_copies)
        self.instances = tuple(sorted({*self.drive.actors, *copies}))
        self._number = {name: number for number, name in enumerate(self.instances, 1)}
        self._entries = sorted(self._listed(manifest.key("times")))
        first = [entry.time_ns for entry in self._entries[:1]]
        first += [step.time_us * 1000 for step in islice(stream_steps(path), 1)]
        self.shift_ns = max(0, math.ceil(-min(first, default=0) / SECOND_NS)) * SECOND_NS
        self._mounts = self._find_mounts()
        self._labels = lru_cache(MOST_LABELS)(self._read_labels)

    def about(self) -> dict[str, str]:
        """Return the data that messages do not contain, as texts: the drive's name, the world's origin in the log's own
        coordinates (m), the offset added to times, the instances' names, all cameras' models, and by how much sensors
        move beside their mounts at most (m, rad), as JSON."""
        cameras = {name: camera.model.to_dict() for name, camera in self.drive.cameras.items()}
        return {
            "drive": self.drive.name,
            "world_origin": json.dumps(np.asarray(self.drive.world_origin).tolist()),
            "shift_ns": str(self.shift_ns),
            "instances": json.dumps(self.instances),
            "cameras": json.dumps(cameras),
            "mounts_move": json.dumps({name: [off_m, off_rad] for name, (_, off_m, off_rad) in self._mounts.items()}),
        }

    def name_of(self, image: ImageMessage) -> str:
        """Return what an image is called in files that name it."""
        name = image.path.relative_to(self.path).as_posix()
        return self._images.get(name, name)

    def messages(self) -> Iterator[Message]:
        """Yield everything in the order of time; a capture's files are read when it is its turn. Raises `LogError` and
        `OutputError` for files that are missing or broken."""
        files = ((entry.time_ns + self.shift_ns, entry.rank, entry) for entry in self._entries)
        # behind the labels of the same time
        driven = ((message.time_ns, 0.5, message) for message in self._driven())
        if self._mounts and self._entries:
            yield self._mounted()
        merged: Iterator[tuple[int, float, _Entry | RolloutEgo | PlannedPoses]]
        merged = heapq.merge(files, driven, key=lambda one: one[:2])
        for _, _, item in merged:
            yield self._message(item) if isinstance(item, _Entry) else item

    def images(self) -> Iterator[tuple[ImageMessage, Node]]:
        """Yield all images in the order of time, and of each the part of the labels that has the boxes' poses in its camera's
        frame, by actor. Raises as `messages`."""
        for entry in self._entries:
            if KINDS[entry.rank] == CAMERA:
                yield self._image(entry), self._sensor(entry).key("boxes")

    def _listed(self, times: Node) -> Iterator[_Entry]:
        sensors = {f"{CAMERA}/{name}" for name in self.drive.cameras} | {
            f"{LIDAR}/{name}" for name in self.drive.lidars
        }
        for moment, node in times.members():
            for name, time in node.members():
                if name != "time_s" and name not in sensors:
                    time.fail("is of no sensor that was rendered")
                kind, _, sensor_id = (LABELS if name == "time_s" else name).partition("/")
                yield _Entry(round(time.number() * SECOND_NS), KINDS.index(kind), sensor_id, moment)

    def _message(self, entry: _Entry) -> Message:
        if KINDS[entry.rank] == LABELS:
            return self._boxes(entry)
        return self._image(entry) if KINDS[entry.rank] == CAMERA else self._sweep(entry)

    def _boxes(self, entry: _Entry) -> BoxLabels:
        labels = self._labels(entry.moment)
        boxes = [_box(node) for node in labels.key("boxes").elements()]
        copies = [_static_copy(node) for node in labels.key("static_copies").elements()]
        return BoxLabels(entry.time_ns + self.shift_ns, _pose(labels.key("world_from_ego")), (*boxes, *copies))

    def _image(self, entry: _Entry) -> ImageMessage:
        path = camera_path(self.path, entry.sensor_id, entry.moment, ".png")
        if not path.is_file():
            raise OutputError(f"{path}: is missing")
        pose = _pose(self._sensor(entry).key("world_from_sensor"))
        model = self.drive.cameras[entry.sensor_id].model
        moved = self._moved(entry, pose)
        return ImageMessage(entry.time_ns + self.shift_ns, entry.sensor_id, pose, moved, path, model)

    def _sweep(self, entry: _Entry) -> SweepMessage:
        path = lidar_path(self.path, entry.sensor_id, entry.moment, ".npz")
        arrays = sweep_arrays(path, instance="iu")
        points = np.zeros(len(arrays["x"]), POINT_FIELDS)
        for name in POINT_FIELDS.names or ():
            points[name] = arrays[name]
        points["instance"] = self._renumbered(path, arrays)
        pose = _pose(self._sensor(entry).key("world_from_sensor"))
        return SweepMessage(entry.time_ns + self.shift_ns, entry.sensor_id, pose, self._moved(entry, pose), points)

    def _find_mounts(self) -> dict[str, tuple[FloatArray, float, float]]:
        """Where sensors sit on the vehicle, and by how much they move beside that, m and rad: of those that ride on it."""
        times: dict[str, list[float]] = {}
        for entry in self._entries:
            times.setdefault(entry.sensor_id, []).append(entry.time_ns / SECOND_NS)
        mounts, sensors = {}, self.drive.sensors
        for name, captured in times.items():
            if name not in sensors:
                continue
            # one that is there once may be anywhere
            every = captured if len(captured) > 1 else sorted({entry.time_ns / SECOND_NS for entry in self._entries})
            at = np.array(every)
            mount = mean_pose(invert_pose(self.drive.world_from_ego.at(at)) @ sensors[name].trajectory.at(at))
            if mount[1] <= STEADY_M and mount[2] <= STEADY_RAD:
                mounts[name] = mount
        return mounts

    def _mounted(self) -> Mounts:
        first = self._entries[0].time_ns + self.shift_ns
        driven = next(self._driven(), None)
        if driven is not None:
            first = min(first, driven.time_ns)
        return Mounts(first, {name: _as_pose(mount) for name, (mount, _, _) in sorted(self._mounts.items())})

    def _moved(self, entry: _Entry, pose: Pose) -> tuple[str, Pose]:
        """The frame of reference that a capture's time places, and its pose then."""
        if entry.sensor_id not in self._mounts:
            return entry.sensor_id, pose
        return EGO, _as_pose(self.drive.world_from_ego.at(entry.time_ns / SECOND_NS))

    def _renumbered(self, path: Path, arrays: dict[str, NDArray[Any]]) -> NDArray[np.int32]:
        names = [str(name) for name in arrays.get("instances", ())]
        unknown = [name for name in names if name not in self._number]
        if unknown:
            raise OutputError(f"{path}: instances holds {short(unknown[0])}, which is no actor of the drive")
        numbers = np.array([0, *(self._number[name] for name in names)], np.int32)
        instance = arrays["instance"]
        if len(instance) and not 0 <= int(instance.min()) <= int(instance.max()) < len(numbers):
            raise OutputError(f"{path}: instance holds a number that instances has no name for")
        return numbers[instance]

    def _sensor(self, entry: _Entry) -> Node:
        return self._labels(entry.moment).key("sensors").key(entry.sensor_id)

    def _read_labels(self, moment: str) -> Node:
        path = labels_path(self.path, moment)
        return Node(read_json(path, OutputError), f"{path}: ", OutputError)

    def _driven(self) -> Iterator[RolloutEgo | PlannedPoses]:
        """The steps of a rollout; a plan comes with the moment that it answered, which is the step before."""
        asked_us = 0
        for before, step, after in _with_neighbours(stream_steps(self.path)):
            if isinstance(step.action, Plan):
                yield self._planned(step.action, asked_us)
            asked_us, ego = step.time_us, step.ego
            pose = self._on_ground(asked_us, ego.x_m, ego.y_m, ego.heading_rad)
            time_ns = asked_us * 1000 + self.shift_ns
            yield RolloutEgo(
                time_ns, pose, ego.speed_m_s, _yaw_rate(before, after), ego.acceleration_m_s2, ego.steering_rad
            )

    def _planned(self, plan: Plan, asked_us: int) -> PlannedPoses:
        rows = zip(plan.x_m.tolist(), plan.y_m.tolist(), plan.heading_rad.tolist(), strict=True)
        poses = tuple(self._on_ground(asked_us, *row) for row in rows)
        times = tuple(time_us * 1000 + self.shift_ns for time_us in plan.times_us.tolist())
        return PlannedPoses(asked_us * 1000 + self.shift_ns, times, poses)

    def _on_ground(self, time_us: int, x_m: float, y_m: float, heading_rad: float) -> Pose:
        """Steps and plans lie in the plane: they are drawn at the height of the ego's frame."""
        height = float(self.drive.world_from_ego.at(time_us / US_PER_SECOND)[2, 3])
        w, x, y, z = quaternion_from_yaw(heading_rad).tolist()
        return Pose((x_m, y_m, height), (w, x, y, z))


def _with_neighbours(steps: Iterator[RolloutStep]) -> Iterator[tuple[RolloutStep, RolloutStep, RolloutStep]]:
    """Yield each step between the one before and the one after; at the ends it stands for the one that is not there."""
    last: list[RolloutStep] = []
    for step in steps:
        last = [*last[-2:], step]
        if len(last) == 2:
            yield last[0], last[0], last[1]
        elif len(last) == 3:
            yield last[0], last[1], last[2]
    if last:
        yield last[max(len(last) - 2, 0)], last[-1], last[-1]


def _yaw_rate(before: RolloutStep, after: RolloutStep) -> float:
    """The mean rate at which the heading turns between two steps, rad/s counter-clockwise."""
    between_us = after.time_us - before.time_us
    turned = math.remainder(after.ego.heading_rad - before.ego.heading_rad, 2 * math.pi)
    return turned * US_PER_SECOND / between_us if between_us > 0 else 0.0


def _as_pose(pose: FloatArray) -> Pose:
    x, y, z = pose[:3, 3].tolist()
    qw, qx, qy, qz = quaternion_from_matrix(pose[:3, :3]).tolist()
    return Pose((x, y, z), (qw, qx, qy, qz))


def _numbers(node: Node, count: int) -> tuple[float, ...]:
    return tuple(node.array(count).tolist())


def _pose(node: Node) -> Pose:
    x, y, z = _numbers(node.key("position"), 3)
    qw, qx, qy, qz = _numbers(node.key("quaternion_wxyz"), 4)
    return Pose((x, y, z), (qw, qx, qy, qz))


def _box(node: Node) -> LabelledBox:
    label, moves = node.key("class").text(), node.key("is_moving").flag()
    x, y, z = _numbers(node.key("size_m"), 3)
    notes = {
        "class": label,
        "is_moving": json.dumps(moves),
        "inserted": json.dumps(node.key("inserted").flag()),
        "velocity_m_s": json.dumps(_numbers(node.key("velocity_m_s"), 3)),
    }
    return LabelledBox(node.key("id").text(), label, _pose(node.key("world")), (x, y, z), moves, notes)


def _static_copy(node: Node) -> LabelledBox:
    x, y, z = _numbers(node.key("size_m"), 3)
    notes = {"class": STATIC_COPY, "is_moving": "false"}
    return LabelledBox(node.key("id").text(), STATIC_COPY, _pose(node.key("world")), (x, y, z), False, notes)
