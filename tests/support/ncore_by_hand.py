"""A sequence written with NCore's own API alone, from exact motion: what a team's converter writes.

The rig drives a circle; its world's z is up, and lies far from the global origin. Nothing of the package's writer is used.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from PIL import Image

from unisim_blender.core.geometry import FloatArray

data = pytest.importorskip("ncore.data", reason="nvidia-ncore is not installed: pip install '.[ncore]'")
v4 = pytest.importorskip("ncore.data.v4")

START_US = 1_700_000_000_000_000
SWEEP_US, SWEEPS = 100_000, 5
RADIUS_M, TURN_RAD_S = 20.0, 0.5
ROWS = np.radians([10.0, 0.0, -10.0]).astype(np.float32)
COLUMNS = 60
ORIGIN = np.array([500_000.25, -4_000_000.5, 120.0])
BOX_SIZE = (4.0, 1.8, 1.5)
CAMERA_FROM = np.array([[0.0, 0, 1, 1.5], [-1, 0, 0, 0.3], [0, -1, 0, 1.4], [0, 0, 0, 1]])
LIDAR_FROM = np.array([[0.0, -1, 0, 0.5], [1, 0, 0, -0.4], [0, 0, 1, 1.9], [0, 0, 0, 1]])
WIDTH, HEIGHT = 40, 24


def rig_pose(seconds: float) -> FloatArray:
    """The rig in the world (4, 4)."""
    yaw = TURN_RAD_S * seconds
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    pose[:3, 3] = [7.0 + RADIUS_M * np.sin(yaw), 9.0 - RADIUS_M * np.cos(yaw), 0.5]
    return pose


def car_pose(seconds: float) -> FloatArray:
    """A car in the world (4, 4)."""
    pose = rig_pose(seconds + 1.0)
    pose[2, 3] = 0.75
    return pose


def ray_of(row: int, column: int) -> FloatArray:
    """A ray's direction (3,) in the LiDAR, which turns clockwise from its back."""
    azimuth = np.pi - 2 * np.pi * column / COLUMNS
    level = float(ROWS[row])
    return np.array([np.cos(level) * np.cos(azimuth), np.cos(level) * np.sin(azimuth), np.sin(level)])


def fired_us(sweep: int, column: int) -> int:
    """When a column is fired."""
    return START_US + sweep * SWEEP_US + SWEEP_US * column // COLUMNS


def depth_of(row: int, column: int) -> float:
    """A ray's distance; NaN for a drop."""
    return float("nan") if column % 10 == 3 else 10.0 + row + 0.1 * column


def image() -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(np.full((HEIGHT, WIDTH, 3), 90, np.uint8)).save(buffer, "PNG")
    return buffer.getvalue()


def exposure_us(number: int) -> int:
    """How long after an image's first row its last one is exposed, as cameras with automatic exposure have it."""
    return 23_000 + 250 * number


def write_by_hand(
    folder: Path,
    store: Literal["itar", "directory"] = "itar",
    groups: bool = False,
    drops: bool = True,
    elements: bool = True,
    spare: int = 1,
    **changes: Any,
) -> Path:
    """Write the sequence and return its JSON file.

    ``groups``: sensors have stores of their own. ``drops``: rays without a return are there. ``elements``: rays have rows and
    columns. ``spare``: the table has so many columns for each that is fired. ``changes`` replace arguments of a sweep's.
    """
    from ncore.impl.common.transformations import HalfClosedInterval
    from upath import UPath

    end = START_US + SWEEPS * SWEEP_US
    writer = v4.SequenceComponentGroupsWriter(
        UPath(folder), "clip", "clip", HalfClosedInterval(START_US, end + 1), {"by": "hand"}, store
    )
    poses = writer.register_component_writer(v4.PosesComponent.Writer, "default")
    times = np.arange(START_US, end + 1, 10_000, dtype=np.uint64)
    track = np.stack([rig_pose((int(time) - START_US) / 1e6) for time in times])
    shift = np.eye(4)
    shift[:3, 3] = ORIGIN
    poses.store_dynamic_pose("rig", "world", track, times)
    poses.store_static_pose("world", "world_global", shift)
    poses.store_static_pose("front", "rig", CAMERA_FROM)
    poses.store_static_pose("roof", "rig", LIDAR_FROM)
    intrinsics = writer.register_component_writer(v4.IntrinsicsComponent.Writer, "default")
    intrinsics.store_camera_intrinsics("front", camera())
    azimuth = np.pi - 2 * np.pi * np.arange(COLUMNS * spare) / (COLUMNS * spare)
    intrinsics.store_lidar_intrinsics(
        "roof",
        data.RowOffsetStructuredSpinningLidarModelParameters(
            spinning_frequency_hz=10.0,
            spinning_direction="cw",
            n_rows=len(ROWS),
            n_columns=len(azimuth),
            row_elevations_rad=ROWS,
            column_azimuths_rad=azimuth.astype(np.float32),
            row_azimuth_offsets_rad=np.zeros(len(ROWS), np.float32),
        ),
    )
    masks = writer.register_component_writer(v4.MasksComponent.Writer, "default")
    masks.store_camera_masks("front", {})
    front = writer.register_component_writer(v4.CameraSensorComponent.Writer, "front", "front" if groups else None)
    for number in range(2 * SWEEPS - 1):  # at twice the LiDAR's rate
        begin = START_US + number * SWEEP_US // 2 + 20_000
        front.store_frame(image(), "png", np.array([begin, begin + exposure_us(number)], np.uint64), {}, {})
    roof = writer.register_component_writer(v4.LidarSensorComponent.Writer, "roof", "roof" if groups else None)
    for sweep in range(SWEEPS):
        cells = [(row, column) for column in range(COLUMNS) for row in range(len(ROWS))]
        cells = [cell for cell in cells if drops or np.isfinite(depth_of(*cell))]
        depth = np.array([[depth_of(*cell) for cell in cells]], np.float32)
        element = np.array([(row, column * spare) for row, column in cells], np.uint16)
        given: dict[str, Any] = {
            "direction": np.array([ray_of(*cell) for cell in cells], np.float32),
            "timestamp_us": np.array([fired_us(sweep, column) for _, column in cells], np.uint64),
            "model_element": element if elements else None,
            "distance_m": depth,
            "intensity": np.where(np.isfinite(depth), np.float32(0.5), np.float32(np.nan)),
        }
        begin = START_US + sweep * SWEEP_US
        stamps = np.array([begin, begin + SWEEP_US - 1], np.uint64)
        given |= {name: change(given[name]) for name, change in changes.items()}
        roof.store_frame(**given, frame_timestamps_us=stamps, generic_data={}, generic_meta_data={})
    cuboids = writer.register_component_writer(v4.CuboidsComponent.Writer, "default")
    cuboids.store_observations([seen(time_us) for time_us in range(START_US + 50_000, end, SWEEP_US)])
    stores = writer.finalize()
    meta = v4.SequenceComponentGroupsReader(stores).get_sequence_meta()
    path = folder / "clip.json"
    path.write_text(meta.to_json())
    return path


def camera() -> Any:
    return data.OpenCVPinholeCameraModelParameters(
        resolution=np.array([WIDTH, HEIGHT], np.uint64),
        shutter_type=data.ShutterType.ROLLING_TOP_TO_BOTTOM,
        external_distortion_parameters=None,
        principal_point=np.array([19.5, 12.25], np.float32),
        focal_length=np.array([30.0, 31.0], np.float32),
        radial_coeffs=np.array([-0.1, 0.02, 0, 0, 0, 0], np.float32),
        tangential_coeffs=np.array([0.001, -0.002], np.float32),
        thin_prism_coeffs=np.zeros(4, np.float32),
    )


def seen(time_us: int) -> Any:
    """The car as it is seen from the rig, at a time of its own."""
    at = np.linalg.inv(rig_pose((time_us + 20_000 - START_US) / 1e6)) @ car_pose((time_us - START_US) / 1e6)
    yaw = float(np.arctan2(at[1, 0], at[0, 0]))
    return data.CuboidTrackObservation(
        track_id="car",
        class_id="Automobile",
        timestamp_us=time_us,
        reference_frame_id="rig",
        reference_frame_timestamp_us=time_us + 20_000,
        bbox3=data.BBox3(tuple(at[:3, 3].tolist()), BOX_SIZE, (0.0, 0.0, yaw)),
        source=data.LabelSource.AUTOLABEL,
    )
