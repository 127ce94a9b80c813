"""When a sensor measures: the window of time that one frame's rays lie in."""

from __future__ import annotations

import numpy as np

from ..world.drive import Camera, Lidar

PAD_LINES = 4
"""Cells of several pixels may reach so many rows or columns beyond an image's edge."""


def exposure_window(sensor: Camera | Lidar, time_s: float) -> tuple[float, float]:
    """Return from when to when, seconds, the rays of a sensor's frame at ``time_s`` leave; ``time_s``
    itself lies within."""
    if isinstance(sensor, Lidar):
        model = sensor.model
        first, last = time_s + model.time_offset_s - model.sweep_s, time_s + model.time_offset_s
        if model.column_time_s is not None:
            first, last = (time_s + model.time_offset_s + float(end(model.column_time_s)) for end in (np.min, np.max))
        if model.beam_time_s is not None:
            early, late = float(model.beam_time_s.min()), float(model.beam_time_s.max())
            first, last = min(first, last) + early, max(first, last) + late
    else:
        shutter = sensor.model_at(time_s).shutter
        pad = PAD_LINES / (sensor.model.width if shutter.axis == "columns" else sensor.model.height)
        first, last = (time_s + shutter.duration_s * (at - shutter.reference) for at in (-pad, 1 + pad))
    return min(time_s, first, last), max(time_s, first, last)
