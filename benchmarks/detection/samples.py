"""A sample: what the two detectors see of one frame, and the vehicles that are there. A set: a folder of
samples, made once.

Boxes from above are x, y, length, width, yaw in the ego frame at the frame's time, metres and radians, where a vehicle
was when the sweep passed it. Boxes in the image are left, top, right, bottom in pixels, of the whole vehicle, hidden
parts too, within the image.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from tqdm import tqdm

from unisim_blender.core.colour import bytes_from_srgb
from unisim_blender.core.data.log import Log
from unisim_blender.core.errors import LogError, OutputError, UnisimError
from unisim_blender.core.files import partial_file, write_file
from unisim_blender.core.geometry import FloatArray, box_corners, invert_pose, points_in_box, transform_points
from unisim_blender.core.json_file import read_json
from unisim_blender.core.sensors.camera import line_times
from unisim_blender.core.sensors.frames import LidarFrame
from unisim_blender.core.world.drive import Actor, Camera, Drive

VEHICLES = (
    "Car",
    "Pickup Truck",
    "Medium-sized Truck",
    "Semi-truck",
    "Bus",
    "Emergency Vehicle",
    "Other Vehicle - Construction Vehicle",
    "Other Vehicle - Uncommon",
)
"""PandaSet's classes that are detected, as one."""

X_M, Y_M, Z_M = (0.0, 80.0), (-40.0, 40.0), (-2.0, 6.0)
"""The region of interest, ego frame: the paper's."""
MARGIN_M = 5.0
"""Points so far outside the region are kept: training turns and shifts the sweep."""
IMAGE_WIDTH = 320
LEAST_POINTS, LEAST_PIXELS, LEAST_INSIDE, MOST_HIDDEN = 5, 10.0, 0.3, 0.7
"""A vehicle counts where so many returns hit it; in the image also where its box is so high, so much of it is in the
image, and no more than this share is behind the boxes of nearer vehicles."""
_SURFACE_M = 0.05
_NEAR_M = 0.2
_EDGES = np.array([(a, b) for a in range(8) for b in range(a) if bin(a ^ b).count("1") == 1])


@dataclass(frozen=True)
class Sample:
    """image (H, W, 3) sRGB; points (N, 4) x, y, z, intensity, ego frame; for V vehicles bev (V, 5), hits (V,) returns
    on each, boxes (V, 4) and inside (V,), the share of a vehicle's projected box that the image holds, 0 where
    it is not in it."""

    image: NDArray[np.uint8]
    points: NDArray[np.float32]
    bev: NDArray[np.float32]
    hits: NDArray[np.int32]
    boxes: NDArray[np.float32]
    inside: NDArray[np.float32]

    @property
    def bev_ignored(self) -> NDArray[np.bool_]:
        """Vehicles (V,) that a detector of sweeps need not find and may."""
        x, y = self.bev[:, 0], self.bev[:, 1]
        inside = (x >= X_M[0]) & (x < X_M[1]) & (y >= Y_M[0]) & (y < Y_M[1])
        return np.asarray((self.hits < LEAST_POINTS) | ~inside)

    @property
    def nearest_first(self) -> NDArray[np.int64]:
        """Numbers (V,) of the vehicles by their distance."""
        return np.argsort(np.hypot(self.bev[:, 0], self.bev[:, 1]), kind="stable")

    @property
    def hidden(self) -> NDArray[np.float64]:
        """Share (V,) of each vehicle's box in the image that lies behind the boxes of nearer ones, to the pixel."""
        covered = np.zeros(self.image.shape[:2], bool)
        out = np.zeros(len(self.boxes))
        for index in self.nearest_first:
            left, top, right, bottom = self.boxes[index].round().astype(int)
            region = covered[top:bottom, left:right]
            out[index] = region.mean() if region.size else 0.0
            region[:] = True
        return out

    @property
    def boxes_ignored(self) -> NDArray[np.bool_]:
        """Vehicles (V,) that a detector of images need not find and may."""
        low = self.boxes[:, 3] - self.boxes[:, 1] < LEAST_PIXELS
        return np.asarray((self.hits < LEAST_POINTS) | low | (self.inside < LEAST_INSIDE) | (self.hidden > MOST_HIDDEN))


@dataclass(frozen=True)
class Key:
    """Which frame of which drive."""

    sequence: str
    frame: int

    @property
    def name(self) -> str:
        """The frame's name in files."""
        return f"{self.sequence}_{self.frame:06d}"


def make_sample(
    drive: Drive,
    frame: int,
    camera: Camera,
    image: NDArray[np.uint8],
    points: FloatArray,
    times_s: FloatArray,
    intensity: NDArray[np.float32],
    sweep_s: float,
) -> Sample:
    """A sample of an image (H, W, 3) and a sweep's returns (N, 3), world frame, with their times and
    intensities (N,)."""
    ego_from_world = invert_pose(drive.world_from_ego.at(drive.time_s[frame]))
    model = camera.model.resized(IMAGE_WIDTH)
    small = resized(image, model.width, model.height)
    camera = Camera(camera.sensor_id, model, camera.world_from_camera, camera.time_s)
    bev, hits, boxes, inside = [], [], [], []
    for actor in drive.actors.values():
        if actor.label not in VEHICLES or not actor.present(drive.time_s[frame]):
            continue
        time = passing_time(actor, drive.time_s[frame] - sweep_s / 2, points, times_s)
        pose = actor.world_from_actor.at(time)
        on_it = points_in_box(points, pose, actor.size_m + 2 * _SURFACE_M)
        bev.append(bev_box(ego_from_world @ pose, actor.size_m))
        hits.append(int(on_it.sum()))
        box, share = image_box(actor, camera, frame)
        boxes.append(box)
        inside.append(share)
    return Sample(
        image=small,
        points=near_points(transform_points(ego_from_world, points), intensity),
        bev=np.array(bev, np.float32).reshape(-1, 5),
        hits=np.array(hits, np.int32),
        boxes=np.array(boxes, np.float32).reshape(-1, 4),
        inside=np.array(inside, np.float32),
    )


def resized(image: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """Return an image (H, W, 3) at another size (height, width, 3)."""
    return np.asarray(Image.fromarray(image).resize((width, height), Image.Resampling.LANCZOS))


def near_points(points: FloatArray, intensity: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the returns (N, 3), (N,) that lie in the region of interest or by its margin, ego frame: (M, 4)."""
    low = np.array([X_M[0], Y_M[0], Z_M[0]]) - MARGIN_M
    high = np.array([X_M[1], Y_M[1], Z_M[1]]) + MARGIN_M
    near = ((points >= low) & (points < high)).all(-1)
    return np.concatenate([points[near], intensity[near, None]], -1).astype(np.float32)


def unlabelled(image: NDArray[np.uint8] | None = None, points: NDArray[np.float32] | None = None) -> Sample:
    """Return a sample without labels, of an image (H, W, 3), of returns (N, 4) as of `near_points`, or both."""
    return Sample(
        image=np.zeros((1, 1, 3), np.uint8) if image is None else image,
        points=np.zeros((0, 4), np.float32) if points is None else points,
        bev=np.zeros((0, 5), np.float32),
        hits=np.zeros(0, np.int32),
        boxes=np.zeros((0, 4), np.float32),
        inside=np.zeros(0, np.float32),
    )


def sample_of(drive: Drive, frame: int, camera_id: str, rgb: NDArray[np.float32], sweep: LidarFrame) -> Sample:
    """A sample of a rendered image (H, W, 3), sRGB, and sweep."""
    on = sweep.returned
    points = sweep.origins[on] + sweep.directions[on] * sweep.depth_m[on, None].astype(np.float64)
    return make_sample(
        drive, frame, drive.cameras[camera_id], bytes_from_srgb(rgb), points, sweep.time_s[on], sweep.intensity[on],
        sweep.model.sweep_s,
    )  # fmt: skip


def passing_time(actor: Actor, guess_s: float, points: FloatArray, times_s: FloatArray) -> float:
    """When a sweep passed an actor: the median time of the returns (N, 3), (N,) near its box, the guess
    where there are none."""
    near = points_in_box(points, actor.world_from_actor.at(guess_s), actor.size_m + 1.0)
    return float(np.median(times_s[near])) if near.any() else guess_s


def bev_box(ego_from_actor: FloatArray, size_m: FloatArray) -> tuple[float, float, float, float, float]:
    """x, y, length, width, yaw of a box at a pose (4, 4) with edges (3,)."""
    yaw = np.arctan2(ego_from_actor[1, 0], ego_from_actor[0, 0])
    return float(ego_from_actor[0, 3]), float(ego_from_actor[1, 3]), float(size_m[0]), float(size_m[1]), float(yaw)


def image_box(actor: Actor, camera: Camera, frame: int) -> tuple[tuple[float, float, float, float], float]:
    """An actor's box in the image, and the share of its projection that the image holds; zeros where it
    is out of sight.

    Camera and actor are where they are when the row of the actor's middle is exposed.
    """
    model, time = camera.model, camera.time_s[frame]
    if not model.is_pinhole or model.shutter.axis != "rows":
        raise UnisimError(f"{camera.sensor_id}: rectangles are made for pinholes that read rows")
    for _ in range(2):
        camera_from_world = invert_pose(camera.world_from_camera.at(time))
        corners = box_corners(camera_from_world @ actor.world_from_actor.at(time), actor.size_m)
        visible = clipped_corners(corners)
        if not len(visible):
            return (0.0, 0.0, 0.0, 0.0), 0.0
        u = model.fx * visible[:, 0] / visible[:, 2] + model.cx
        v = model.fy * visible[:, 1] / visible[:, 2] + model.cy
        time = float(
            line_times(camera, camera.time_s[frame], np.clip(np.array((v.min() + v.max()) / 2), 0, model.height))
        )
    whole = (u.max() - u.min()) * (v.max() - v.min())
    left, right = np.clip([u.min(), u.max()], 0, model.width)
    top, bottom = np.clip([v.min(), v.max()], 0, model.height)
    area = (right - left) * (bottom - top)
    if area <= 0:
        return (0.0, 0.0, 0.0, 0.0), 0.0
    return (float(left), float(top), float(right), float(bottom)), float(area / whole)


def clipped_corners(corners: FloatArray) -> FloatArray:
    """Corners (N, 3) of the part of a box (8, 3) that lies before the camera, camera frame."""
    before = corners[:, 2] >= _NEAR_M
    a, b = corners[_EDGES[:, 0]], corners[_EDGES[:, 1]]
    crossing = (a[:, 2] >= _NEAR_M) != (b[:, 2] >= _NEAR_M)
    a, b = a[crossing], b[crossing]
    t = (_NEAR_M - a[:, 2]) / (b[:, 2] - a[:, 2])
    return np.concatenate([corners[before], a + t[:, None] * (b - a)])


def sample_from_log(log: Log, camera: str, lidar: str, frame: int) -> Sample:
    """A recorded or rendered log's frame."""
    drive = log.drive
    sweep = log.sweep(lidar, frame)
    return make_sample(
        drive, frame, drive.cameras[camera], log.image(camera, frame), sweep.points, sweep.time_s, sweep.intensity,
        drive.lidars[lidar].model.sweep_s,
    )  # fmt: skip


def write_set(out: Path, about: dict[str, Any], keys: Iterable[Key], make: Callable[[Key], Sample]) -> None:
    """Write the samples that a set lacks. Raises `OutputError` where ``out`` holds another set."""
    about = {"format": "detection-set", "version": 1, "image_width": IMAGE_WIDTH, **about}
    file = out / "set.json"
    if out.exists() and any(out.iterdir()):
        if not file.is_file():
            raise OutputError(f"{out}: is not empty and holds no set of samples")
        if read_json(file, OutputError) != json.loads(json.dumps(about)):
            raise OutputError(f"{out}: holds another set of samples, see {file}")
    write_file(file, (json.dumps(about, indent=1) + "\n").encode())
    for key in tqdm(list(keys), desc=out.name, unit="frame"):
        path = out / f"{key.name}.npz"
        if not path.exists():
            sample = make(key)
            with partial_file(path) as temporary, open(temporary, "wb") as target:
                np.savez_compressed(target, **{name: getattr(sample, name) for name in _names()})


def read_set(path: Path) -> dict[Key, Sample]:
    """All samples of a set, in order. Raises `LogError`."""
    files = sorted(path.glob("*.npz"))
    if not files:
        raise LogError(f"{path}: holds no samples")
    return {key_of(file): read_sample(file) for file in files}


def read_sample(path: Path) -> Sample:
    """The sample in a file."""
    with np.load(path, allow_pickle=False) as arrays:
        return Sample(**{name: arrays[name] for name in _names()})


def key_of(path: Path) -> Key:
    """Which frame a sample's file is of."""
    sequence, _, frame = path.stem.rpartition("_")
    return Key(sequence, int(frame))


def settings(value: Any) -> dict[str, Any]:
    """A dataclass as a JSON object."""
    return json.loads(json.dumps(asdict(value)))


def _names() -> list[str]:
    return [field.name for field in fields(Sample)]
