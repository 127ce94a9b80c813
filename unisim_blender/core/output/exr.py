"""Camera frames as OpenEXR files: named channels, linear Rec.709, camera metadata in the header.

Channels: R G B (linear Rec.709, half) and A, 1 everywhere: the background is part of the image, so it is opaque and its
colour premultiplied; depth, z_depth (m, float; inf where nothing was hit), normal.X .Y .Z (world frame, half), instance
(float, whole numbers: programs scale integer channels to 0..1 where they read all channels as float; 0 is the background, n the
n-th name of the header's instances), opacity (half; of all that is nearer than the
background) and unsupported (half; 1 where no recorded ray supports the pixel). A pass that was not
rendered has no channel.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from ..colour import linear_from_srgb
from ..files import partial_file
from ..sensors.frames import CameraFrame
from ..world.captures import Capture

REC709_CHROMATICITIES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
METADATA_ATTRIBUTE = "unisim"
"""Header attribute with a JSON object: OpenEXR keeps single numbers as float32, and a time needs more."""


def exr_channels(frame: CameraFrame) -> dict[str, NDArray[Any]]:
    """The frame's passes as arrays (H, W) by channel name."""
    linear = linear_from_srgb(np.clip(frame.rgb, 0, 1))
    channels: dict[str, NDArray[Any]] = {name: linear[..., i].astype(np.float16) for i, name in enumerate("RGB")}
    channels["A"] = np.ones(frame.rgb.shape[:2], np.float16)
    if frame.depth_m is not None:
        channels["depth"] = frame.depth_m.astype(np.float32)
    if frame.z_depth_m is not None:
        channels["z_depth"] = frame.z_depth_m.astype(np.float32)
    if frame.normal is not None:
        channels |= {f"normal.{axis}": frame.normal[..., i].astype(np.float16) for i, axis in enumerate("XYZ")}
    if frame.instance is not None:
        channels["instance"] = frame.instance.astype(np.float32)
    if frame.opacity is not None:
        channels["opacity"] = frame.opacity.astype(np.float16)
    if frame.unsupported is not None:
        channels["unsupported"] = frame.unsupported.astype(np.float16)
    return {name: np.ascontiguousarray(values) for name, values in channels.items()}


def camera_metadata(frame: CameraFrame, capture: Capture, time_s: float) -> dict[str, Any]:
    """What a reader needs to use the image as a measurement; ``time_s`` is the image's timestamp. An image that is none
    of the log's has ``time_us`` in place of ``frame``."""
    model = frame.model
    return {
        "sensor": capture.sensor_id,
        **({"time_us": capture.time_us} if capture.frame is None else {"frame": capture.frame}),
        "time_s": time_s,
        "width": model.width,
        "height": model.height,
        "K": [[model.fx, 0.0, model.cx], [0.0, model.fy, model.cy], [0.0, 0.0, 1.0]],
        "world_from_camera": frame.world_from_camera.tolist(),
        "camera_axes": "x right, y down, z forward",
        "shutter": model.shutter.to_dict(),
        **({} if model.is_pinhole else {"lens": model.lens.to_dict()}),
        "instances": list(frame.instances),
    }


def write_exr(path: Path, frame: CameraFrame, metadata: dict[str, Any]) -> None:
    """Write the frame with ``metadata`` (`camera_metadata`) in its header. Raises `OutputError`."""
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "chromaticities": REC709_CHROMATICITIES,
        "K": np.array(metadata["K"], np.float64),
        "world_from_camera": np.array(metadata["world_from_camera"], np.float64),
        METADATA_ATTRIBUTE: json.dumps(metadata),
    }
    with partial_file(path) as temporary:
        OpenEXR.File(header, exr_channels(frame)).write(str(temporary))
