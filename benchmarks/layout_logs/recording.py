"""One recording of the procedural street by sensors that every layout has a place for.

The camera has a global shutter, as nuScenes' and KITTI's. The LiDAR has 32 rings, as nuScenes', which meet in one point, and a
turn of 50 ms; it looks forward as the camera takes its image. Everything is drawn once; layouts differ in what they keep of it.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, field, replace
from pathlib import Path

import kitti_street as kitti
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from unisim_blender.core.data.log import Drops, Sweep
from unisim_blender.core.formats.ncore.write import NcoreWriter
from unisim_blender.core.formats.pandaset.write import PandasetWriter, returns_of
from unisim_blender.core.geometry import FloatArray, invert_pose, make_pose, quaternion_from_yaw
from unisim_blender.core.lenses.lens import Lens
from unisim_blender.core.sensors.frames import LidarFrame
from unisim_blender.core.world.drive import Camera, CameraModel, Drive, Lidar, LidarModel
from unisim_street.street import Street, build_street
from unisim_street.truth import truth_camera, truth_lidar

CAMERA, LIDAR = "front_camera", "pandar64"
TURN_S = 0.05
COLUMNS = 900
FARTHEST_M = 80.0
"""KITTI's sweeps hold no return from further away."""
ELEVATION_DEG = np.concatenate([np.linspace(4.0, -8.0, 22), np.linspace(-9.5, -24.0, 10)])
FOCAL_SHARE = 0.6
"""Focal length in image widths: 80 degrees across."""
JPEG_QUALITY = 95


@dataclass(frozen=True)
class Size:
    """What is recorded: frames, ten a second, and the images' size."""

    frames: int = 21
    width: int = 240
    height: int = 136
    seed: int = 11

    @property
    def rig(self) -> kitti.KittiRig:
        """The same rig in KITTI's words; its matrix counts pixels from the first one's centre."""
        focal = FOCAL_SHARE * self.width
        return kitti.KittiRig(
            frames=self.frames,
            trigger_s=-TURN_S / 2,
            turn_s=TURN_S,
            farthest_m=np.inf,
            focal=focal,
            cx=self.width / 2 - 0.5,
            cy=self.height / 2 - 0.5,
            image_lag_s=0.010,
        )


@dataclass
class Recording:
    """The street, the recorded drive, and of each frame the encoded image and the sweep."""

    size: Size
    street: Street
    images: dict[int, bytes] = field(default_factory=dict)
    sweeps: dict[int, LidarFrame] = field(default_factory=dict)

    @property
    def drive(self) -> Drive:
        """The recorded drive."""
        return self.street.drive

    def with_lens(self, lens: Lens) -> Recording:
        """The same street through another lens: sweeps are the same, images are not drawn yet."""
        camera = self.drive.cameras[CAMERA]
        seen = replace(camera, model=replace(camera.model, lens=lens))
        drive = replace(self.drive, cameras={CAMERA: seen})
        return Recording(self.size, replace(self.street, drive=drive), {}, self.sweeps)

    def draw(self, frames: tuple[int, ...] | None = None) -> None:
        """Draw what is not drawn yet."""
        for frame in self.drive.frames if frames is None else frames:
            if frame not in self.images:
                image = truth_camera(self.street, self.drive, CAMERA, frame)
                self.images[frame] = _jpeg(np.rint(image.rgb * 255).astype(np.uint8))
            if frame not in self.sweeps:
                self.sweeps[frame] = truth_lidar(self.street, self.drive, LIDAR, frame)


def make_recording(size: Size) -> Recording:
    """The street and the drive through it; nothing is drawn."""
    street = build_street(size.seed, size.frames, size.width, size.height, (CAMERA,), range_noise_m=0.0)
    drive, rig = street.drive, size.rig
    ego_from_lidar = make_pose(kitti.LIDAR_PLACE, quaternion_from_yaw(kitti.LIDAR_YAW))
    table = LidarModel(
        elevation_rad=np.radians(ELEVATION_DEG),
        azimuth_offset_rad=np.zeros(len(ELEVATION_DEG)),
        columns=COLUMNS,
        sweep_s=TURN_S,
        max_range_m=FARTHEST_M,
    )
    lidar = Lidar(LIDAR, table, drive.world_from_ego.transformed(right=ego_from_lidar), dict(drive.time_s))
    model = CameraModel(size.width, size.height, rig.focal, rig.focal, rig.cx + 0.5, rig.cy + 0.5)
    camera = Camera(
        CAMERA,
        model,
        drive.world_from_ego.transformed(right=ego_from_lidar @ lidar_from_camera(rig)),
        {frame: time - TURN_S / 2 for frame, time in drive.time_s.items()},
    )
    return Recording(size, replace(street, drive=replace(drive, cameras={CAMERA: camera}, lidars={LIDAR: lidar})))


def lidar_from_camera(rig: kitti.KittiRig) -> FloatArray:
    """Pose (4, 4) of KITTI's image_02 in the LiDAR's frame, by its calibration's own chain."""
    camera0_from_lidar = np.eye(4)
    turn = kitti.rectified() @ kitti.CAMERA_AXES
    camera0_from_lidar[:3, :3], camera0_from_lidar[:3, 3] = turn, -turn @ kitti.CAMERA_PLACE
    projection = rig.projection(2)
    camera_from_camera0 = np.eye(4)
    camera_from_camera0[:3, 3] = np.linalg.solve(projection[:, :3], projection[:, 3])
    return invert_pose(camera_from_camera0 @ camera0_from_lidar)


def decoded(image: bytes) -> NDArray[np.uint8]:
    """The image (H, W, 3) in a file's bytes."""
    return np.asarray(Image.open(io.BytesIO(image)).convert("RGB"))


def write_pandaset(recording: Recording, path: Path) -> Path:
    """The recording in PandaSet's layout, the reference; gives the path that opens it."""
    writer = PandasetWriter(path, recording.drive)
    for frame in recording.drive.frames:
        file = writer.image_path(CAMERA, frame)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(recording.images[frame])
        writer.write_sweep(frame, {LIDAR: recording.sweeps[frame]})
        writer.write_cuboids(frame)
    writer.finish()
    return path


def write_ncore(recording: Recording, path: Path) -> Path:
    """The recording as an NCore sequence, with its drops; gives the path that opens it."""
    with NcoreWriter(path, recording.drive) as writer:
        for frame in recording.drive.frames:
            writer.write_image(CAMERA, frame, recording.images[frame])
            writer.write_sweep(LIDAR, frame, _with_drops(recording.sweeps[frame]))
    return path


def _with_drops(frame: LidarFrame) -> Sweep:
    ring, column = np.nonzero(~frame.returned)
    cell = ring, column
    drops = Drops(
        frame.origins[cell], frame.directions[cell], frame.time_s[cell], ring.astype(np.int32), column.astype(np.int32)
    )
    return replace(returns_of(frame), drops=drops)


def _jpeg(rgb: NDArray[np.uint8]) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(rgb).save(buffer, "JPEG", quality=JPEG_QUALITY, subsampling=0)
    return buffer.getvalue()
