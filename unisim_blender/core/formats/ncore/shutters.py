"""When NCore's images are exposed: the middles of the first and the last line's exposure, in the order that they are read.

Line i of H is exposed at ``start + (end - start) * i / (H - 1)``, counted from the side that is read first; a global shutter's
image as a whole at ``start`` (NCore's `image_points_relative_frame_times`). Ours count from a line's edge, middle i + 0.5.
"""

from __future__ import annotations

import numpy as np

from ...geometry import FloatArray
from ...world.drive import Camera, Readouts, RollingShutter

TYPES = {
    ("rows", False): "ROLLING_TOP_TO_BOTTOM",
    ("rows", True): "ROLLING_BOTTOM_TO_TOP",
    ("columns", False): "ROLLING_LEFT_TO_RIGHT",
    ("columns", True): "ROLLING_RIGHT_TO_LEFT",
}
ROUNDED_S = 2.5e-6
"""Start and end are whole microseconds: spans that differ by no more are the same."""
GLOBAL = "GLOBAL"
"""Names of NCore's `ShutterType`; True where the last line is read first."""


def shutter_type(shutter: RollingShutter) -> str:
    """Return the name of NCore's type of a shutter."""
    return GLOBAL if shutter.duration_s == 0 else TYPES[shutter.axis, shutter.duration_s < 0]


def exposed(camera: Camera, time_s: float) -> tuple[float, float]:
    """Return when the first and the last line to be read of an image stamped ``time_s`` are exposed, by their middles."""
    model = camera.model_at(time_s)
    shutter = model.shutter
    half = 0.5 / _lines(model.width, model.height, shutter.axis)
    ends = [time_s + shutter.duration_s * (at - shutter.reference) for at in (half, 1 - half)]
    return min(ends), max(ends)


def shutter_of(name: str, span_s: float, width: int, height: int) -> RollingShutter:
    """Return the shutter of an NCore type whose last line is exposed ``span_s`` after its first. Images are stamped with the
    middle between both, a global shutter's with their start."""
    known = {value: key for key, value in TYPES.items()}
    if name not in known or span_s == 0:
        return RollingShutter()
    axis, reverse = known[name]
    lines = _lines(width, height, axis)
    duration = span_s * lines / max(lines - 1, 1)
    return RollingShutter(-duration if reverse else duration, 0.5, axis)


def readouts_of(name: str, stamps_s: FloatArray, spans_s: FloatArray, span_s: float) -> Readouts | None:
    """Return how images stamped ``stamps_s`` (K,) differ whose last lines are exposed ``spans_s`` (K,) after their first, in
    place of ``span_s``; None where that is rounding."""
    if name == GLOBAL or len(spans_s) == 0 or (spans_s <= 0).any() or np.ptp(spans_s) <= ROUNDED_S:
        return None
    times, first = np.unique(stamps_s, return_index=True)
    return Readouts(times, spans_s[first] / span_s)


def stamp(name: str, start_s: float, end_s: float) -> float:
    """Return the timestamp of an image that `shutter_of` refers to."""
    return start_s if name == GLOBAL else (start_s + end_s) / 2


def _lines(width: int, height: int, axis: str) -> int:
    return width if axis == "columns" else height
