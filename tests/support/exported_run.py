"""A finished folder to export: a tiny sequence whose labels, images and sweeps are there, and lines of a rollout."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_drive import FRONT, FakeMethod, recipe_of, tiny_plan
from turning_drive import turning_drive

from unisim_blender.core.geometry import FloatArray, Trajectory
from unisim_blender.core.render.captures import CaptureStates
from unisim_blender.core.render.visibility import Reach
from unisim_blender.core.sequence.run import render_sequence
from unisim_blender.core.simulation.rollout.steps import STEPS_NAME, RolloutStep
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.simulation.vehicle.actions import Control, Plan
from unisim_blender.core.world.captures import moments_of
from unisim_blender.core.world.drive import Drive
from unisim_blender.core.world.replay import DriveStates

FRAMES = (0, 1, 3)
PLAN = Plan(
    np.array([100_000, 200_000, 300_000]),
    np.array([0.5, 1.0, 1.5]),
    np.array([0.0, 0.1, 0.3]),
    np.array([0.0, 0.1, 0.2]),
)
STEPS = (
    RolloutStep(0, EgoState(0.0, 0.0, 0.0, 5.0), {}),
    RolloutStep(100_000, EgoState(0.5, 0.01, 0.02, 4.9, -1.0, 0.05), {}, PLAN),
    RolloutStep(200_000, EgoState(1.0, 0.02, 0.04, 4.8, -1.1, 0.06), {}, Control(-1.0, 0.1)),
)


def render_tiny(out: Path, earlier_s: float = 0.0, aside: bool = False) -> Path:
    """Render some frames of the tiny drive, all of its sensors ``earlier_s`` before their frames, its camera beside the road if
    it is to stand ``aside``; the folder."""
    plan = tiny_plan()
    drive = plan.drive
    times = {frame: time_s - earlier_s for frame, time_s in drive.time_s.items()}
    cameras = {name: replace(camera, time_s=times) for name, camera in drive.cameras.items()}
    if aside:
        still = Trajectory(np.zeros(1), np.array([[3.0, 8.0, 5.0]]), np.array([FRONT]))
        cameras = {name: replace(camera, world_from_camera=still) for name, camera in cameras.items()}
    drive = replace(drive, cameras=cameras)
    moments = tuple(plan.moment_of_frame(frame) for frame in FRAMES)
    settings = replace(plan.settings, formats=("png", "npz", "labels"), passes=("rgb",))
    plan = replace(plan, drive=drive, settings=settings)
    moments = tuple(plan.moment_of_frame(frame) for frame in FRAMES)
    render_sequence(replace(plan, moments=moments), out)
    return out


def render_turn(out: Path) -> tuple[Path, Drive]:
    """Render the frames of a drive that turns to the left, and write the steps of its rear axle, which moves as the frame of the
    vehicle does; the folder, and the drive."""
    drive = turning_drive()
    # the renderer of these tests shows a car and a cone
    drive = replace(drive, actors={**drive.actors, "cone": replace(drive.actors["van"], uid="cone")})
    settings = replace(tiny_plan().settings, cameras=("front",), lidars=("top",), formats=("png", "npz", "labels"))
    settings = replace(settings, passes=("rgb",))
    moments = moments_of(drive, drive.frames, None, ("front",), ("top",))
    captures = CaptureStates(DriveStates(drive, {}), Reach())
    plan = replace(
        tiny_plan(),
        drive=drive,
        moments=moments,
        settings=settings,
        recipe=recipe_of(FakeMethod(drive)),
        captures=captures,
    )
    render_sequence(plan, out)
    steps = []
    for time_us in range(0, 1_000_001, 100_000):
        pose = drive.world_from_ego.at(time_us * 1e-6)
        heading = float(np.arctan2(pose[1, 0], pose[0, 0]))
        steps.append(RolloutStep(time_us, EgoState(float(pose[0, 3]), float(pose[1, 3]), heading, 8.0, 0.0, 0.17), {}))
    (out / STEPS_NAME).write_text("".join(json.dumps(step.to_json()) + "\n" for step in steps))
    return out, drive


def as_rollout(folder: Path) -> Path:
    """Write the steps of a rollout into a finished folder; the folder."""
    (folder / STEPS_NAME).write_text("".join(json.dumps(step.to_json()) + "\n" for step in STEPS))
    return folder


def labels_of(folder: Path) -> list[dict[str, Any]]:
    """The labels' documents, in the order of frames."""
    return [json.loads(path.read_text()) for path in sorted((folder / "labels").glob("*.json"))]


def all_files(folder: Path) -> dict[str, bytes]:
    """Every file's bytes below a folder, or a file's, by its path below it."""
    paths = [folder] if folder.is_file() else sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


class FrameTree:
    """Frames of reference with their transforms over time, looked up as ROS's and Foxglove's programs do: exactly at a time."""

    def __init__(self) -> None:
        self._moving: dict[str, tuple[str, dict[int, FloatArray]]] = {}
        self._still: dict[str, tuple[str, FloatArray]] = {}

    def add(self, parent: str, child: str, pose: FloatArray, time_ns: int | None) -> None:
        """Add a transform (4, 4); of one that holds for ever ``time_ns`` is None. A frame has one parent."""
        if time_ns is None:
            assert child not in self._moving and child not in self._still
            self._still[child] = parent, pose
            return
        assert child not in self._still
        known, poses = self._moving.setdefault(child, (parent, {}))
        assert known == parent
        assert time_ns not in poses or np.allclose(poses[time_ns], pose, rtol=0, atol=1e-9)
        poses[time_ns] = pose

    def in_world(self, frame: str, time_ns: int) -> FloatArray:
        """The pose (4, 4) of a frame in the world at a time."""
        pose = np.eye(4)
        while frame != "world":
            if frame in self._still:
                parent, own = self._still[frame]
            else:
                parent, poses = self._moving[frame]
                own = poses[time_ns]
            pose, frame = own @ pose, parent
        return pose


def check_turn(
    tree: FrameTree, frames: dict[int, set[str]], drive: Drive, twists: list[tuple[int, float, float]]
) -> None:
    """Check what is written of `render_turn`: ``frames`` that messages name, by their times, and ``twists``, times, speeds ahead
    and rates of yaw of the rear axle."""
    assert {name for names in frames.values() for name in names} == {"world", "front", "top", "rear_axle"}
    for time_ns, names in frames.items():
        for name in names:
            tree.in_world(name, time_ns)
    offset_s = (min(frames) - round(min(drive.cameras["front"].time_s.values()) * 1e9)) * 1e-9
    sensors = {"front": drive.cameras["front"].world_from_camera, "top": drive.lidars["top"].world_from_lidar}
    for time_ns, names in frames.items():
        for name in names & set(sensors):
            found = tree.in_world(name, time_ns)
            # between its keys, a tenth of a second apart, the vehicle cuts corners by 5 mm
            np.testing.assert_allclose(found, sensors[name].at(time_ns * 1e-9 - offset_s), rtol=0, atol=6e-3)
    times = [time_ns for time_ns, _, _ in twists]
    poses = [tree.in_world("rear_axle", time_ns) for time_ns in times]
    assert len(times) == 11
    for at in range(1, len(times) - 1):
        between_s = (times[at + 1] - times[at - 1]) * 1e-9
        velocity = (poses[at + 1][:3, 3] - poses[at - 1][:3, 3]) / between_s
        turned = poses[at - 1][:3, :3].T @ poses[at + 1][:3, :3]
        own = poses[at][:3, :3].T @ velocity
        np.testing.assert_allclose(own, [twists[at][1], 0, 0], rtol=0, atol=0.01)
        assert twists[at][2] == pytest.approx(np.arctan2(turned[1, 0], turned[0, 0]) / between_s, abs=1e-6)
    assert [rate for _, _, rate in twists] == pytest.approx([0.5] * 11, abs=1e-6)
