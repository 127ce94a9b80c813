"""A reader of logs: a folder of images with a file of poses, without LiDAR."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from unisim_blender.core.data.log import Sweep, SweepGrid
from unisim_blender.core.errors import LogError
from unisim_blender.core.geometry import Trajectory
from unisim_blender.core.world.drive import Camera, CameraModel, Drive


class ImageFolderLog:
    """A folder with poses.json and front/000000.png and so on."""

    def __init__(self, path: Path) -> None:
        self.path = path
        values = json.loads((path / "poses.json").read_text())
        times = {int(frame): float(time) for frame, time in values["time_s"].items()}
        keys = np.array(list(times.values()))
        positions, quaternions = np.array(values["positions"], float), np.array(values["quaternions_wxyz"], float)
        # a camera looks along its z axis, 1.6 m above the vehicle's origin, along the vehicle's x axis
        world_from_ego = Trajectory(keys, positions - positions[0], quaternions)
        vehicle_from_camera = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 1.6], [0, 0, 0, 1]])
        world_from_camera = Trajectory.from_poses(keys, world_from_ego.at(keys) @ vehicle_from_camera)
        camera = Camera("front", CameraModel(**values["camera"]), world_from_camera, times)
        self.drive = Drive(path.name, tuple(times), times, world_from_ego, {"front": camera}, {}, {})
        self.missing = tuple(f"front: no image of frame {f}" for f in times if self.image_path("front", f) is None)

    def image_frames(self, camera: str) -> tuple[int, ...]:
        return tuple(frame for frame in self.drive.frames if self.image_path(camera, frame) is not None)

    def sweep_frames(self, lidar: str) -> tuple[int, ...]:
        return ()

    def image_path(self, camera: str, frame: int) -> Path | None:
        path = self.path / camera / f"{frame:06d}.png"
        return path if path.is_file() else None

    def image(self, camera: str, frame: int) -> NDArray[np.uint8]:
        path = self.image_path(camera, frame)
        if path is None:
            raise LogError(f"{self.path}: {camera} has no image of frame {frame}")
        return np.asarray(Image.open(path).convert("RGB"), np.uint8)

    def sweep(self, lidar: str, frame: int) -> Sweep:
        raise LogError(f"{self.path}: has no LiDAR")

    def sweep_grid(self, lidar: str, frame: int) -> SweepGrid:
        raise LogError(f"{self.path}: has no LiDAR")


class ImageFolderReader:
    """Recognises and opens such folders."""

    name = "image-folder"
    layout = "image folder: a folder with poses.json"  # for messages
    suffixes = (".json",)  # of files that open the log where they are dropped onto Blender's window

    @staticmethod
    def recognises(path: Path) -> bool:
        return (path / "poses.json").is_file()

    @staticmethod
    def open(path: Path) -> ImageFolderLog:
        return ImageFolderLog(path)
