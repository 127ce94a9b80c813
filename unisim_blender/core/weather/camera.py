"""Weather in images: light attenuated on its way, and airlight of the sky's colour at the horizon (Koschmieder 1924;
Nayar & Narasimhan, ICCV 1999)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb, srgb_from_linear
from ..geometry import FloatArray
from ..sensors.camera import camera_rays, pixel_grid
from ..sensors.frames import CameraFrame
from ..world.drive import Camera
from ..world.weather import Weather
from .atmosphere import extinctions, transmittance

HORIZON_WIDTH_RAD = 0.15
"""Angle above the horizon over which the sky counts less, by a factor e, for the airlight."""
CLOUDY_SHARE = 0.02
"""Share of an image that what is no sky counts for, so that the airlight does not jump where the last sky vanishes."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)


def airlight(frame: CameraFrame, camera: Camera, time_s: float) -> FloatArray:
    """Return the airlight (3,), linear Rec.709, that a whole clear image of a camera with depths shows: the colour of the
    sky near the horizon, with a little of the grey of the image's brightest tenth, which is all where no sky is seen."""
    assert frame.depth_m is not None
    colours = linear_from_srgb(frame.rgb).reshape(-1, 3)
    up = camera_rays(camera, time_s, *pixel_grid(frame.model)).directions[..., 2].reshape(-1)
    sky = np.isinf(frame.depth_m.reshape(-1)) & (np.abs(up) <= 1)
    weights = np.where(sky, np.exp(-np.abs(np.where(sky, up, 0.0)) / HORIZON_WIDTH_RAD), 0.0)
    grey = float(np.quantile(colours @ LUMINANCE, 0.9))
    rest = CLOUDY_SHARE * len(colours)
    return np.asarray((weights @ colours + rest * grey) / (weights.sum() + rest))


def weathered(frame: CameraFrame, weather: Weather, light: FloatArray) -> NDArray[np.float32]:
    """Return the colours (H, W, 3), sRGB, of a clear frame with depths in weather; ``light`` (3,) is the airlight."""
    assert frame.depth_m is not None
    through = transmittance(sum(extinctions(weather).values()), frame.depth_m)[..., None]
    image = linear_from_srgb(frame.rgb)
    image -= light.astype(np.float32)
    image *= through
    image += light.astype(np.float32)
    return srgb_from_linear(image)
