"""A trained scene against the recorded frames it was not trained on, and the renderer interface that evaluation requires.

Full-frame metrics are means over frames (and cameras) of the frames' own metrics. Metrics inside actors' boxes pool the
squared errors of all frames' pixels first, for a box is a few pixels in one frame and half the image in another. LiDAR
metrics are means over sweeps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..data.images import resize_image, shown_pixels
from ..data.log import Log, SweepRays
from ..data.own_vehicle import Outline, shows_scene
from ..data.sweep_cells import known_rays
from ..geometry import BoolArray, FloatArray, intersect_boxes, invert_pose
from ..render.captures import render_image, states_of
from ..render.renderer import Renderer
from ..sensors.camera import camera_rays, pixel_grid
from ..sensors.frames import CameraFrame
from ..sensors.rays import Rays
from ..sensors.unprojection import image_mask
from ..world.captures import Capture
from ..world.drive import Actor, Camera, CameraModel, Drive, LidarModel
from ..world.own_rates import captures_of
from .images import METRES_PER_PIXEL, CaptionedImage, ReturnCloud, depth_image, difference_image, outline, sweep_tile
from .lidar_metrics import lidar_metrics
from .metrics import ImageArray, chamfer, mean_of, mean_squared_error, psnr, psnr_from_error, ssim

RayResults = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]
"""Depth (m), intensity, probability of a return and instance of LiDAR rays, each (N,)."""


class RayRenderer(Protocol):
    """Renderer of camera images and LiDAR rays, as evaluation requires it."""

    def camera(
        self, camera_id: str, frame: int, passes: tuple[str, ...] = ("rgb",), width: int | None = None
    ) -> CameraFrame:
        """Render the image of a frame of the log, ``width`` pixels wide (None: as recorded)."""

    def rays_lidar(self, origins: FloatArray, directions: FloatArray, time_s: FloatArray) -> RayResults:
        """Render LiDAR rays (N, 3), (N, 3), world frame, at times (N,)."""


class TimedRenderer:
    """A `RayRenderer` of a drive. ``seconds`` are those of each camera frame and each sweep."""

    def __init__(self, renderer: Renderer, drive: Drive) -> None:
        self.renderer, self.states = renderer, states_of(renderer, drive)
        self.seconds: dict[str, list[float]] = {"camera": [], "lidar": []}

    def camera(
        self, camera_id: str, frame: int, passes: tuple[str, ...] = ("rgb",), width: int | None = None
    ) -> CameraFrame:
        begun = time.perf_counter()
        capture = Capture.of_frame(self.states.camera(camera_id), frame)
        image = render_image(self.renderer, self.states, capture, passes, width)
        self.seconds["camera"].append(time.perf_counter() - begun)
        return image

    def rays_lidar(self, origins: FloatArray, directions: FloatArray, time_s: FloatArray) -> RayResults:
        begun = time.perf_counter()
        times = time_s[np.isfinite(time_s)]
        window = (float(times.min()), float(times.max())) if times.size else (0.0, 0.0)
        results = self.renderer.beams(self.states.states.state(*window), Rays(origins, directions, time_s))
        self.seconds["lidar"].append(time.perf_counter() - begun)
        return results

    def medians(self) -> dict[str, float | None]:
        """Return the median seconds of a camera frame and of a sweep, without the first of each, which fills caches."""
        return {kind: float(np.median(times[1:] or times)) if times else None for kind, times in self.seconds.items()}


DRIVING_M_S = 0.5
"""Frames in which the ego vehicle is faster count as driving."""
Perceptual = Callable[[ImageArray, ImageArray], float]
"""LPIPS of a rendered and a recorded image (H, W, 3)."""


@dataclass(frozen=True)
class EvaluationPlan:
    """Which frames of which sensors are rendered and compared with the recording."""

    frames: tuple[int, ...]
    cameras: tuple[str, ...]
    lidars: tuple[str, ...]
    width: int | None
    """Width of the compared images, pixels; None for the recorded one."""
    trained: tuple[int, ...]
    """The frames that were trained on. The mean of the two nearest is compared, too: what copying them would give."""
    perceptual: Perceptual | None = None
    between: bool = False
    """Whether images and sweeps between the frames that belong to them are compared, too (`world/own_rates.py`)."""
    outlines: dict[str, tuple[Outline, int]] = field(default_factory=dict)
    """Where each camera's images show the recording vehicle itself, by the camera's name: its outline (see
    `data/own_vehicle.py`) and the height of the images that it was found in. Pixels that show it are not compared."""


@dataclass
class FrameImages:
    """One frame's images for the report, one row a sensor."""

    frame: int
    rows: list[Sequence[CaptionedImage]] = field(default_factory=list)


def evaluate(
    renderer: RayRenderer,
    log: Log,
    plan: EvaluationPlan,
    on_frame: Callable[[FrameImages], None] = lambda images: None,
    progress: Callable[[Iterable[int]], Iterable[int]] = lambda frames: frames,
) -> dict[str, Any]:
    """Render the plan's frames and compare them with the log; the metrics as a JSON object (None where
    there are none)."""
    per_frame = []
    taken = _captures(log, plan)
    for frame in progress(tuple(taken)):
        images, (cameras, lidars) = FrameImages(frame), taken[frame]
        speed = ego_speed(log.drive, _time_of(log.drive, frame, cameras, lidars))
        record: dict[str, Any] = {
            "frame": frame,
            "ego_speed_m_s": speed,
            "driving": speed > DRIVING_M_S,
            "camera": {},
            "lidar": {},
        }
        for name in cameras:
            record["camera"][name], row = _camera_frame(renderer, log, plan, name, frame)
            images.rows.append(row)
        for name in lidars:
            record["lidar"][name], row = _lidar_frame(renderer, log, name, frame)
            images.rows.append(row)
        per_frame.append(record)
        on_frame(images)
    metrics: dict[str, Any] = finite({**summarise_frames(per_frame), "per_frame": per_frame})
    return metrics


def _captures(log: Log, plan: EvaluationPlan) -> dict[int, tuple[list[str], list[str]]]:
    """The numbers of frames, and of captures between them, in this order, and which cameras and LiDARs have them."""
    taken: dict[int, tuple[list[str], list[str]]] = {frame: ([], []) for frame in plan.frames}
    sensors = [
        *((0, name, log.drive.cameras[name].time_s, log.image_frames(name)) for name in plan.cameras),
        *((1, name, log.drive.lidars[name].time_s, log.sweep_frames(name)) for name in plan.lidars),
    ]
    for kind, name, time_s, there in sensors:
        for number in captures_of(time_s, log.drive, plan.frames, there):
            if plan.between or number in taken:
                taken.setdefault(number, ([], []))[kind].append(name)
    order = [*plan.frames, *sorted(taken.keys() - set(plan.frames))]
    return {number: taken[number] for number in order}


def _time_of(drive: Drive, number: int, cameras: list[str], lidars: list[str]) -> float:
    """A frame's time, or that of the first sensor whose capture between frames has a number."""
    if number in drive.time_s:
        return drive.time_s[number]
    return drive.cameras[cameras[0]].time_s[number] if cameras else drive.lidars[lidars[0]].time_s[number]


def ego_speed(drive: Drive, time: float) -> float:
    """The ego vehicle's speed in m/s, over the tenth of a second around a time that lies within the drive."""
    keys = drive.world_from_ego.times_s
    start, end = max(time - 0.05, keys[0]), min(time + 0.05, keys[-1])
    if end <= start:
        return 0.0
    positions = drive.world_from_ego.at(np.array([start, end]))[:, :3, 3]
    return float(np.linalg.norm(positions[1] - positions[0]) / (end - start))


def recorded_image(log: Log, camera: str, frame: int, width: int | None) -> ImageArray:
    """The recorded image (H, W, 3) in 0..1; at another width every pixel is the mean of what it covers."""
    image = resize_image(log.image(camera, frame), resized_camera(log.drive.cameras[camera], width).model)
    return np.asarray(image, np.float32) / np.float32(255)


def neighbour_average(log: Log, plan: EvaluationPlan, camera: str, frame: int) -> ImageArray | None:
    """The mean of the nearest recorded images before and after that were trained on; None where one side has none."""
    time_s = log.drive.cameras[camera].time_s
    images = [n for n in captures_of(time_s, log.drive, sorted(plan.trained), log.image_frames(camera)) if n != frame]
    before = [other for other in images if time_s[other] < time_s[frame]]
    after = [other for other in images if time_s[other] > time_s[frame]]
    if not before or not after:
        return None
    return (recorded_image(log, camera, before[-1], plan.width) + recorded_image(log, camera, after[0], plan.width)) / 2


def resized_camera(camera: Camera, width: int | None) -> Camera:
    """The camera with its images at another width."""
    model = camera.model if width is None else camera.model.resized(width)
    return replace(camera, model=model, full_width=None, sees_ego_body=False)


def scene_mask(plan: EvaluationPlan, camera: str, model: CameraModel, shown: BoolArray | None) -> BoolArray | None:
    """The pixels (H, W), of those that the lens shows, that show the scene and not the vehicle itself; None where all do."""
    if camera not in plan.outlines:
        return shown
    scene = shows_scene(*plan.outlines[camera], *pixel_grid(model), (model.width, model.height))
    return scene if shown is None else scene & shown


def image_metrics(
    rendered: ImageArray, recorded: ImageArray, masks: dict[str, BoolArray], scene: BoolArray | None = None
) -> dict[str, Any]:
    """PSNR and SSIM over the frame, or the part of it that is ``scene``, and within each mask with its pixels and mean
    squared error, from which PSNR is pooled."""
    metrics: dict[str, Any] = {"psnr_db": psnr(rendered, recorded, scene), "ssim": ssim(rendered, recorded, scene)}
    for name, mask in masks.items():
        error = mean_squared_error(rendered, recorded, mask)
        metrics[name] = {
            "psnr_db": psnr_from_error(error),
            "ssim": ssim(rendered, recorded, mask),
            "mean_squared_error": error,
            "pixels": int(mask.sum()),
        }
    return metrics


def _camera_frame(
    renderer: RayRenderer, log: Log, plan: EvaluationPlan, name: str, frame: int
) -> tuple[dict[str, Any], list[CaptionedImage]]:
    recorded = recorded_image(log, name, frame, plan.width)
    image = renderer.camera(name, frame, ("rgb", "depth"), plan.width)
    rendered = np.clip(image.rgb, 0, 1)
    camera = resized_camera(log.drive.cameras[name], plan.width)
    actors = log.drive.actors.values()
    moving = actor_mask(camera, frame, (actor for actor in actors if actor.is_moving))
    inside = moving | actor_mask(camera, frame, (actor for actor in actors if not actor.is_moving))
    masks = {"actors": inside, "moving_actors": moving, "outside_actors": ~inside}
    shown = shown_pixels(log.drive.cameras[name].model, camera.model)
    scene = scene_mask(plan, name, camera.model, shown)
    if scene is not None:
        masks = {key: mask & scene for key, mask in masks.items()}
    metrics = image_metrics(rendered, recorded, masks, scene)
    if plan.perceptual is not None:
        pair = (rendered, recorded) if shown is None else (rendered * shown[..., None], recorded * shown[..., None])
        metrics["lpips"] = plan.perceptual(*pair)
    neighbours = neighbour_average(log, plan, name, frame)
    metrics["neighbour_average_psnr_db"] = None if neighbours is None else psnr(neighbours, recorded, scene)
    eight_bit = (recorded * 255).astype(np.uint8)
    tiles = [
        CaptionedImage(f"{name} {frame}: recorded", outline(eight_bit, inside)),
        CaptionedImage(f"rendered {metrics['psnr_db']:.2f} dB", (rendered * 255).astype(np.uint8)),
        CaptionedImage("difference (white: 0.25)", difference_image(rendered, recorded)),
    ]
    if image.depth_m is not None:
        tiles.append(CaptionedImage("depth (2 to 120 m)", depth_image(image.depth_m)))
    return metrics, tiles


def compare_rays(
    renderer: RayRenderer, rays: SweepRays, model: LidarModel
) -> tuple[dict[str, Any], ReturnCloud, ReturnCloud]:
    """Render LiDAR rays: the metrics, the rendered returns, and the rays' own."""
    depth, intensity, probability, _ = renderer.rays_lidar(rays.origins, rays.directions, rays.time_s)
    returned = (probability >= 0.5) & (depth >= model.min_range_m) & (depth <= model.max_range_m)

    def cloud(hit: BoolArray, depth_m: NDArray[np.float32], intensity: NDArray[np.float32]) -> ReturnCloud:
        points = rays.origins[hit] + rays.directions[hit] * depth_m[hit, None].astype(np.float64)
        return ReturnCloud(points, intensity[hit])

    rendered, own = cloud(returned, depth, intensity), cloud(rays.returned, rays.depth_m, rays.intensity)
    metrics = lidar_metrics(depth, intensity, returned, rays.depth_m, rays.intensity, rays.returned)
    return metrics | chamfer(rendered.points, own.points), rendered, own


def _lidar_frame(renderer: RayRenderer, log: Log, name: str, frame: int) -> tuple[dict[str, Any], list[CaptionedImage]]:
    lidar, rays = log.drive.lidars[name], known_rays(log, name, frame)
    metrics, rendered, recorded = compare_rays(renderer, rays, lidar.model)
    metrics["rays"] = len(rays.returned)
    ego, median = log.drive.world_from_ego.at(lidar.time_s[frame]), metrics["depth_median_m"]
    labels = f"{name} {frame}: recorded, from above", f"rendered, median {median * 100:.1f} cm"
    clouds = zip(labels, (recorded, rendered), strict=True)
    return metrics, [sweep_tile(label, cloud, ego, (640, 480), METRES_PER_PIXEL) for label, cloud in clouds]


MASKS = ("actors", "moving_actors", "outside_actors")
CAMERA_METRICS = ("psnr_db", "ssim", "lpips", "neighbour_average_psnr_db")
LIDAR_METRICS = (
    "depth_median_m",
    "depth_p90_m",
    "depth_mean_m",
    "depth_median_squared_m2",
    "hit_rate",
    "drop_accuracy",
    "intensity_rmse",
    "chamfer_m",
    "chamfer_squared_m2",
)


def summarise_frames(per_frame: list[dict[str, Any]]) -> dict[str, Any]:
    """All frames' metrics, those of driving frames beside them, and each sensor's own."""
    summary: dict[str, Any] = {}
    for kind, metrics in (("camera", camera_metrics), ("lidar", sweep_metrics)):
        driving = [record for record in per_frame if record["driving"]]
        summary[kind] = metrics(_of_sensors(per_frame, kind))
        summary[kind]["driving"] = metrics(_of_sensors(driving, kind))
        names = dict.fromkeys(name for record in per_frame for name in record[kind])
        summary[kind]["by_sensor"] = {name: metrics(_of_sensors(per_frame, kind, name)) for name in names}
    return summary


def camera_metrics(images: list[dict[str, Any]], masks: Iterable[str] = MASKS) -> dict[str, Any]:
    """The images' mean metrics, and those within each mask."""
    metrics: dict[str, Any] = {"images": len(images), **{name: mean_of(images, name) for name in CAMERA_METRICS}}
    if all("lpips" not in image for image in images):
        del metrics["lpips"]
    for mask in masks:
        parts = [image[mask] for image in images if mask in image and image[mask]["pixels"]]
        pixels = sum(part["pixels"] for part in parts)
        error = sum(part["mean_squared_error"] * part["pixels"] for part in parts)
        metrics[mask] = {
            "psnr_db": psnr_from_error(error / pixels) if pixels else None,
            "ssim": mean_of(parts, "ssim"),
            "pixels": pixels,
        }
    return metrics


def sweep_metrics(sweeps: list[dict[str, Any]]) -> dict[str, Any]:
    """The sweeps' mean metrics."""
    return {"sweeps": len(sweeps), **{name: mean_of(sweeps, name) for name in LIDAR_METRICS}}


def _of_sensors(per_frame: list[dict[str, Any]], kind: str, sensor: str | None = None) -> list[dict[str, Any]]:
    return [metrics for record in per_frame for name, metrics in record[kind].items() if sensor in (None, name)]


def finite(value: Any) -> Any:
    """The same document with None for numbers that are not finite, which JSON does not have."""
    if isinstance(value, dict):
        return {key: finite(member) for key, member in value.items()}
    if isinstance(value, list | tuple):
        return [finite(member) for member in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value


def actor_mask(camera: Camera, frame: int, actors: Iterable[Actor]) -> BoolArray:
    """Pixels (H, W) whose ray hits the box of one of the actors where it is at the ray's own time, occluded or not."""
    u, v = pixel_grid(camera.model)
    rays = camera_rays(camera, camera.time_s[frame], u, v)
    if camera.model.shutter.axis == "columns":
        # below, what comes first are the lines that are exposed together
        rays = Rays(rays.origins.swapaxes(0, 1), rays.directions.swapaxes(0, 1), rays.time_s.T)
    times = rays.time_s[:, 0]
    mask = np.zeros(rays.time_s.shape, bool)
    for actor in actors:
        rows = np.flatnonzero(actor.present(times))
        if not len(rows):
            continue
        # a line has one time, so one pose a line serves all its rays; few of them pass through the sphere round a box
        to = actor.world_from_actor.positions_at(times[rows]) - rays.origins[rows, 0]
        radius = float(np.linalg.norm(actor.size_m)) / 2 + 1e-6
        along = (rays.directions[rows] @ to[:, :, None])[..., 0]
        away = (to**2).sum(1, keepdims=True) - radius**2
        row, column = np.nonzero((away <= 0) | ((along > 0) & (along**2 >= away)))
        box_from_world = invert_pose(actor.world_from_actor.at(times[rows]))[row, None]
        place = rows[row], column
        near, far = intersect_boxes(
            rays.origins[place], rays.directions[place], box_from_world, np.asarray(actor.size_m)[None]
        )
        mask[place] |= ((near <= far) & (far > 0))[:, 0]
    if camera.model.shutter.axis == "columns":
        mask = mask.T
    shown = image_mask(camera.model)
    return mask if shown is None else mask & shown
