"""Directions of sensors as yaw (to the left) and pitch (up), in radians."""

from __future__ import annotations

import numpy as np

from ...core.geometry import FloatArray

AHEAD = {"CAMERA": (0.0, 0.0, -1.0), "LIDAR": (1.0, 0.0, 0.0)}
"""Where sensors look in their objects' axes."""
STEEPEST_RAD = np.radians(89.0)


def angles(direction: FloatArray) -> tuple[float, float]:
    """Return yaw and pitch of a direction (3,) of any length."""
    unit = direction / np.linalg.norm(direction)
    return float(np.arctan2(unit[1], unit[0])), float(np.arcsin(np.clip(unit[2], -1, 1)))


def level_axes(yaw: float, pitch: float) -> FloatArray:
    """Axes (3, 3) that look along yaw and pitch without roll."""
    a, b, c, d = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    return np.array([[a, -b, 0], [b, a, 0], [0, 0, 1]]) @ np.array([[c, 0, -d], [0, 1, 0], [d, 0, c]])


def turned_to(axes: FloatArray, base: FloatArray, kind: str, yaw_rad: float, pitch_rad: float) -> FloatArray:
    """Return a sensor's axes (3, 3) turned until it looks along yaw and pitch in the axes ``base`` (3, 3) of the
    vehicle; its roll stays, and its pitch is at most `STEEPEST_RAD`. ``kind`` is CAMERA or LIDAR."""
    before = level_axes(*angles(base.T @ axes @ np.array(AHEAD[kind])))
    pitch_rad = float(np.clip(pitch_rad, -STEEPEST_RAD, STEEPEST_RAD))
    return np.asarray(base @ level_axes(yaw_rad, pitch_rad) @ before.T @ base.T @ axes)
