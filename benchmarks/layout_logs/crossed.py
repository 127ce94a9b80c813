"""A scene trained through one lens, rendered through another, beside what the other recorded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from unisim_blender.core.evaluation.metrics import psnr
from unisim_blender.core.evaluation.recorded import recorded_image
from unisim_blender.core.evaluation.recorded_runs import trained_frames
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import BoolArray
from unisim_blender.core.prepare.replay import replayed_drive
from unisim_blender.core.render.captures import render_image, states_of
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.scenes.recipe import load_backend
from unisim_blender.core.scenes.scene import open_scene
from unisim_blender.core.world.captures import Capture
from unisim_blender.core.world.drive import CameraModel

from .recording import CAMERA


def crossed_psnr(scene: Path, trained_on: Path, rendered_as: Path, seen_by: Path) -> float:
    """Mean PSNR of held-out frames, rendered through the camera of the log ``rendered_as`` from where the scene's own stands.

    Pixels count that the camera of ``seen_by``, another log of the same street and mount, looks at as well.
    """
    opened, own, log = open_scene(scene), open_log(trained_on), open_log(rendered_as)
    header = opened.header
    drive = replayed_drive(header, own)
    model = log.drive.cameras[CAMERA].model
    camera = replace(drive.cameras[CAMERA], model=model, time_s=log.drive.cameras[CAMERA].time_s)
    renderer = Renderer(load_backend(opened))
    states = states_of(renderer, replace(drive, cameras={CAMERA: camera}))
    both = seen_too(model, open_log(seen_by).drive.cameras[CAMERA].model)
    trained = trained_frames(header)
    found = []
    for frame in log.drive.frames:
        if frame not in trained:
            rendered = np.clip(render_image(renderer, states, Capture.of_frame(camera, frame)).rgb, 0, 1)
            found.append(psnr(rendered, recorded_image(log, CAMERA, frame, None), both))
    return float(np.mean(found))


def seen_too(model: CameraModel, other: CameraModel) -> BoolArray:
    """The pixels (H, W) of a camera through which another one in the same place looks as well, both lenses showing them."""
    v, u = np.mgrid[: model.height, : model.width] + 0.5
    directions = model.unproject(u, v)
    shown = np.isfinite(directions).all(-1)
    at_u, at_v, valid = other.project(np.where(shown[..., None], directions, (0.0, 0.0, -1.0)))
    with np.errstate(invalid="ignore"):
        inside = (at_u > 0) & (at_u < other.width) & (at_v > 0) & (at_v < other.height)
    return np.asarray(shown & valid & inside)
