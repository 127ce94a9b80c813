"""A scenario's sensors: those of the log, changed ones, and new ones on mounts of their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from ...geometry import FloatArray, Trajectory, matrix_from_quaternion
from ...lenses import PINHOLE, lens_from_dict
from ...lenses.lens import Lens, LensError
from ...sensors.beam_tables import BEAM_TABLES
from ...sensors.unprojection import shows_something
from ...world.drive import Camera, CameraModel, Drive, Lidar, LidarModel, RollingShutter
from ..checks import fail, listed
from ..context import EditContext, riding, sensor_span_s
from ..motion.placement import Offset, Placement, pose_of, rotation_of
from ..motion.trajectories import merged_times, sampled
from .document import CameraSpec, LidarSpec, Shutter

FRONT_FROM_OPTICAL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""OpenCV axes (x right, y down, z forward) in axes x forward, y left, z up."""

SensorT = TypeVar("SensorT", Camera, Lidar)


def select_sensors(drive: Drive, context: EditContext) -> Drive:
    """Return the drive with the sensors that the scenario lists, on the edited vehicle."""
    sensors, source = context.scenario.sensors, context.scenario.path
    if sensors is None:
        return drive
    cameras, lidars = drive.cameras, drive.lidars
    if sensors.cameras is not None:
        specs = [(spec, f"{source}: sensors.cameras[{i}]") for i, spec in enumerate(sensors.cameras)]
        cameras = {spec.id: _camera(drive, spec, place, context) for spec, place in specs}
    if sensors.lidars is not None:
        beams = [(spec, f"{source}: sensors.lidars[{i}]") for i, spec in enumerate(sensors.lidars)]
        lidars = {spec.id: _lidar(drive, spec, place, context) for spec, place in beams}
    if shared := sorted(cameras.keys() & lidars.keys()):
        fail(f"{source}: sensors", f'"{shared[0]}" is a camera and a LiDAR: give each a name of its own')
    return replace(drive, cameras=cameras, lidars=lidars)


def _base(known: dict[str, SensorT], spec: CameraSpec | LidarSpec, place: str, kind: str) -> SensorT | None:
    """Return the log's sensor that a new one is made from; None for one that is new in all."""
    key = spec.like or spec.id
    if key in known:
        return known[key]
    if spec.like is not None:
        fail(f"{place}.like", f'no {kind} "{spec.like}" in the log {listed(known)}')
    if spec.mount is None and spec.trajectory is None:
        fail(
            f"{place}.id", f'no {kind} "{spec.id}" in the log {listed(known)}; a new one needs a mount or a trajectory'
        )
    return None


def _times(drive: Drive, base: Camera | Lidar | None, offset_s: float) -> dict[int, float]:
    times = drive.time_s if base is None else base.time_s
    return {frame: time + offset_s for frame, time in times.items()} if offset_s else dict(times)


def _camera(drive: Drive, spec: CameraSpec, place: str, context: EditContext) -> Camera:
    base = _base(drive.cameras, spec, place, "camera")
    model = new_camera_model(spec, place) if base is None else _changed_camera_model(base.model, spec, place)
    recorded = None if base is None else base.world_from_camera
    trajectory = _trajectory(drive, spec, recorded, FRONT_FROM_OPTICAL, context, place)
    late_s = spec.time_offset_s or 0.0
    readouts = None if base is None or spec.shutter is not None else base.readouts
    if readouts is not None and late_s:
        readouts = replace(readouts, times_s=readouts.times_s + late_s)
    return Camera(spec.id, model, trajectory, _times(drive, base, late_s), _sees_ego_body(spec), readouts=readouts)


def _sees_ego_body(spec: CameraSpec | LidarSpec) -> bool:
    """Return whether a sensor sees the ego vehicle's body: unless told otherwise, one that does not ride on the vehicle
    does."""
    return spec.trajectory is not None if spec.sees_ego_body is None else spec.sees_ego_body


def _shutter(shutter: Shutter | None, old: RollingShutter) -> RollingShutter:
    if shutter is None:
        return old
    return RollingShutter(
        shutter.duration_s,
        old.reference if shutter.reference is None else shutter.reference,
        old.axis if shutter.axis is None else shutter.axis,
    )


def camera_members(model: CameraModel, old: CameraModel | None = None) -> dict[str, Any]:
    """Return a camera model as members of a `CameraSpec` that changes an ``old`` one, or is new:
    `_changed_camera_model` and `new_camera_model` make it of them again. Shutter and lens go without saying where they
    are the old one's, or a new one's."""
    before = CameraModel(1, 1, 1, 1, 0, 0) if old is None else old
    shutter, axis = model.shutter, None if model.shutter.axis == before.shutter.axis else model.shutter.axis
    return {
        **{name: getattr(model, name) for name in ("width", "height", "fx", "fy", "cx", "cy")},
        "shutter": None if shutter == before.shutter else Shutter(shutter.duration_s, shutter.reference, axis),
        "lens": None if model.lens == before.lens else model.lens.to_dict(),
    }


def _lens(spec: CameraSpec, old: Lens, place: str) -> Lens:
    if spec.lens is None:
        return old
    try:
        return lens_from_dict(spec.lens)
    except LensError as fault:
        fail(f"{place}.lens", str(fault))


def new_camera_model(spec: CameraSpec, place: str) -> CameraModel:
    """Return the model of a camera that no log has. Raises `ScenarioError` naming ``place``."""
    if spec.width is None or spec.height is None or (spec.fx is None) == (spec.horizontal_fov_deg is None):
        fail(place, "a new camera needs width, height, and fx or horizontal_fov_deg")
    lens = _lens(spec, PINHOLE, place)
    fx = _focal_length(spec, spec.width, lens, place) or spec.fx
    assert fx is not None  # one of both is there
    model = CameraModel(
        width=spec.width,
        height=spec.height,
        fx=float(fx),
        fy=float(fx if spec.fy is None else spec.fy),
        cx=spec.width / 2 if spec.cx is None else float(spec.cx),
        cy=spec.height / 2 if spec.cy is None else float(spec.cy),
        shutter=_shutter(spec.shutter, RollingShutter()),
        lens=lens,
    )
    return _showing(model, place)


def _showing(model: CameraModel, place: str) -> CameraModel:
    """Return the model, whose image shows something. Raises `ScenarioError`."""
    if not shows_something(model):
        degrees, at = np.degrees(model.lens.max_angle_rad), f"({model.cx:g}, {model.cy:g})"
        fail(place, f"its image lies beside all that the lens shows, {degrees:.1f} degrees about the pixel {at}")
    return model


def _changed_camera_model(old: CameraModel, spec: CameraSpec, place: str) -> CameraModel:
    """Return the old model at another size (its view scaled with each axis), then with the K and shutter that are
    given."""
    if spec.fx is not None and spec.horizontal_fov_deg is not None:
        fail(place, "has fx beside horizontal_fov_deg, which exclude each other")
    model = old.resized(spec.width) if spec.width is not None else old
    if spec.height is not None and spec.height != model.height:
        sy = spec.height / old.height
        model = replace(model, height=spec.height, fy=old.fy * sy, cy=old.cy * sy)
    lens = _lens(spec, model.lens, place)
    focal = _focal_length(spec, model.width, lens, place)
    if focal is not None:
        model = replace(model, fx=focal, fy=focal)
    given: dict[str, Any] = {
        name: float(getattr(spec, name)) for name in ("fx", "fy", "cx", "cy") if getattr(spec, name) is not None
    }
    return _showing(replace(model, shutter=_shutter(spec.shutter, model.shutter), lens=lens, **given), place)


def _focal_length(spec: CameraSpec, width: int, lens: Lens, place: str) -> float | None:
    """Return the focal length at which an image is as wide as is asked for, half of it to each side of the optical
    axis."""
    if spec.horizontal_fov_deg is None:
        return None
    if lens != PINHOLE:
        half = float(np.radians(spec.horizontal_fov_deg) / 2)
        plane, valid = lens.project(np.array([np.sin(half), 0.0, np.cos(half)]))
        if not valid or not plane[0] > 0:
            widest = 2 * np.degrees(lens.max_angle_rad)
            fail(
                f"{place}.horizontal_fov_deg", f"{spec.horizontal_fov_deg:g} is more than the {widest:.1f} of the lens"
            )
        return float(width / 2 / plane[0])
    if spec.horizontal_fov_deg >= 180:
        fail(
            f"{place}.horizontal_fov_deg",
            f"{spec.horizontal_fov_deg:g} is no angle of a pinhole, which sees less than 180",
        )
    return float(width / 2 / np.tan(np.radians(spec.horizontal_fov_deg) / 2))


def _lidar(drive: Drive, spec: LidarSpec, place: str, context: EditContext) -> Lidar:
    base = _base(drive.lidars, spec, place, "LiDAR")
    model = lidar_model(None if base is None else base.model, spec, place)
    trajectory = _trajectory(drive, spec, None if base is None else base.world_from_lidar, np.eye(3), context, place)
    blocked = None
    if base is not None and base.model is model and trajectory is base.world_from_lidar:
        blocked = base.blocked  # what the vehicle hides is known for the recorded beams on the recorded mount alone
    return Lidar(
        spec.id,
        model,
        trajectory,
        _times(drive, base, 0.0),
        blocked,
        _sees_ego_body(spec),
        None if base is None else base.phase,
    )


def lidar_model(old: LidarModel | None, spec: LidarSpec, place: str) -> LidarModel:
    """Return the model of a LiDAR that changes an old one, or is new. Raises `ScenarioError` naming ``place``."""
    if spec.preset is not None and spec.elevation_deg is not None:
        fail(place, "has preset beside elevation_deg, which exclude each other")
    changes: dict[str, Any] = {
        name: getattr(spec, name)
        for name in ("columns", "sweep_s", "direction", "time_offset_s", "min_range_m", "max_range_m")
        if getattr(spec, name) is not None
    }
    if spec.start_azimuth_deg is not None:
        changes["start_azimuth_rad"] = float(np.radians(spec.start_azimuth_deg))
    model = old
    if spec.preset is not None:
        model = BEAM_TABLES[spec.preset]()
    elif spec.elevation_deg is not None:
        elevation = np.radians(np.array(spec.elevation_deg, float))
        table = {"elevation_rad": elevation, "azimuth_offset_rad": np.zeros_like(elevation)}
        model = LidarModel(**table) if old is None else replace(old, **table, beam_time_s=None)
    if model is None:
        fail(place, "a new LiDAR needs preset or elevation_deg")
    columns = next((len(t) for t in (spec.column_azimuth_deg, spec.column_time_s) if t is not None), model.columns)
    columns = changes.setdefault("columns", columns) if columns != model.columns else changes.get("columns", columns)
    tables = _tables(spec, model.beams, columns, place)
    if not changes and not tables:
        return model
    try:
        model = replace(model, **{**changes, **_resampled(model, changes), **tables})
    except ValueError as fault:
        fail(place, str(fault).replace("_rad", "_deg"))
    if model.min_range_m >= model.max_range_m:
        fail(place, f"min_range_m {model.min_range_m:g} must lie below max_range_m {model.max_range_m:g}")
    return model


def lidar_members(model: LidarModel) -> dict[str, Any]:
    """Return a beam table as members of a `LidarSpec`, of which `lidar_model` makes it again, to rounding of its
    angles."""

    def listed_in(unit: Callable[[FloatArray], FloatArray], table: FloatArray | None) -> tuple[float, ...] | None:
        return None if table is None else tuple(unit(table).tolist())

    return {
        "elevation_deg": listed_in(np.degrees, model.elevation_rad),
        "azimuth_offset_deg": listed_in(np.degrees, model.azimuth_offset_rad),
        "beam_time_s": listed_in(np.asarray, model.beam_time_s),
        "columns": model.columns,
        "column_azimuth_deg": listed_in(np.degrees, model.column_azimuth_rad),
        "column_time_s": listed_in(np.asarray, model.column_time_s),
        "sweep_s": model.sweep_s,
        "start_azimuth_deg": float(np.degrees(model.start_azimuth_rad)),
        "direction": model.direction,
        "time_offset_s": model.time_offset_s,
        "min_range_m": model.min_range_m,
        "max_range_m": model.max_range_m,
    }


def _tables(spec: LidarSpec, beams: int, columns: int, place: str) -> dict[str, Any]:
    """Return the tables that a spec gives, one value for each beam or column."""
    tables = {}
    for name, count, what in (
        ("azimuth_offset_deg", beams, "beams"),
        ("beam_time_s", beams, "beams"),
        ("column_azimuth_deg", columns, "columns"),
        ("column_time_s", columns, "columns"),
    ):
        values = getattr(spec, name)
        if values is None:
            continue
        if len(values) != count:
            fail(f"{place}.{name}", f"has {len(values)} values for {count} {what}")
        table = np.array(values, float)
        tables[name.replace("_deg", "_rad")] = np.radians(table) if name.endswith("_deg") else table
    return tables


def _resampled(model: LidarModel, changes: dict[str, Any]) -> dict[str, Any]:
    """Tables of columns that are not even, as other columns have them; none where what changes is what they say."""
    azimuth, time_s = model.column_azimuth_rad, model.column_time_s
    if "start_azimuth_rad" in changes or "direction" in changes:
        azimuth = None
    if "sweep_s" in changes:
        time_s = None
    if "columns" in changes:
        new, old = ((np.arange(count) + 0.5) / count for count in (changes["columns"], model.columns))
        azimuth = None if azimuth is None else np.interp(new, old, np.unwrap(azimuth))
        time_s = None if time_s is None else np.interp(new, old, time_s)
    return {"column_azimuth_rad": azimuth, "column_time_s": time_s}


def _trajectory(
    drive: Drive,
    spec: CameraSpec | LidarSpec,
    recorded: Trajectory | None,
    front_from_sensor: FloatArray,
    context: EditContext,
    place: str,
) -> Trajectory:
    """Return the sensor's trajectory in the world: one of its own, or on the vehicle."""
    if spec.mount is not None:
        return riding(drive, mounted_pose(spec.mount, front_from_sensor))
    if spec.trajectory is None:
        assert recorded is not None  # a sensor without a mount is one of the log
        return recorded if spec.mount_offset is None else _displaced(drive, recorded, spec.mount_offset)
    # a key with angles looks along x at 0, as a mount does
    own = context.trajectory(None, spec.trajectory, None, place)
    turned = np.array([key.quaternion_wxyz is None for key in spec.trajectory])
    poses = own.poses
    poses[turned, :3, :3] = poses[turned, :3, :3] @ front_from_sensor
    return Trajectory.from_poses(own.times_s, poses)


def mounted_pose(mount: Placement, front_from_sensor: FloatArray) -> FloatArray:
    """Return a sensor's pose (4, 4) on the vehicle; of a mount with angles, axes that look along x at 0 are
    ``front_from_sensor``."""
    ego_from_sensor = pose_of(mount)
    if mount.quaternion_wxyz is None:
        ego_from_sensor[:3, :3] = ego_from_sensor[:3, :3] @ front_from_sensor
    return ego_from_sensor


def _displaced(drive: Drive, recorded: Trajectory, offset: Offset) -> Trajectory:
    """Return a sensor's trajectory in the world, moved and turned on the vehicle."""
    ego, moved = drive.world_from_ego, np.array(offset.position or (0.0, 0.0, 0.0), float)
    turned = matrix_from_quaternion(rotation_of(offset))

    def poses_at(t: FloatArray) -> FloatArray:
        axes, pose = ego.at(t)[:, :3, :3], recorded.at(t)
        pose[:, :3, 3] += axes @ moved
        pose[:, :3, :3] = axes @ turned @ np.swapaxes(axes, -1, -2) @ pose[:, :3, :3]
        return pose

    return sampled(poses_at, merged_times(ego.times_s, recorded.times_s, np.array(sensor_span_s(drive))))
