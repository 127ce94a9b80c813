"""The finished scene of a training, its header, and previews on the way.

A scene marks the voxels that its recording shows: those that images and LiDAR returns end in, and those that they look
through.
"""

from __future__ import annotations

import copy
import dataclasses
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from ..data.exposures import Exposures
from ..data.images import resize_image, shown_pixels
from ..data.log import Log, extras_of
from ..data.own_vehicle import outlines_from_json, outlines_to_json, shows_scene
from ..data.sweep_cells import known_rays
from ..errors import LogError, OutputError, SceneError
from ..files import write_file
from ..geometry import FloatArray, Trajectory, invert_pose, transform_points
from ..model.checkpoint import TorchScene, save_scene
from ..model.scene import SceneModel
from ..model.scene_file import SceneHeader
from ..ops.ray_segments import RayBatch
from ..render.captures import CaptureStates, render_image, states_of
from ..render.confidence import RIGHT_RGB, TOLERANCE, TOLERANCE_M
from ..render.quality import QUALITIES
from ..render.renderer import Renderer
from ..render.tracer import NEAR_M, Backend
from ..render.tracers.compiled.scene import cells_to_store
from ..render.tracers.torch.tracer import TorchBackend, to_batch
from ..sensors.camera import camera_rays, pixel_grid
from ..sensors.frames import CameraFrame, RenderStats
from ..sensors.rays import Rays, exposure_window
from ..sensors.unprojection import has_direction
from ..world.captures import Capture
from ..world.drive import Camera, Drive, Lidar
from ..world.own_rates import captures_of
from ..world.replay import DriveStates
from .trainer import Trainer

BOXES_NAME = "boxes.json"
"""Name of the file of boxes that a scene was trained on, in its folder."""


def with_own_boxes(log: Log, out: Path) -> Log:
    """Return a log whose boxes are those of a file in the folder ``out``, which is written: a scene's actors stay those
    that it was trained on. A log without a file of boxes is returned as it is. Raises `SceneError` where the folder
    holds other boxes, and `OutputError`."""
    text_at, file = extras_of(log).boxes_at, out / BOXES_NAME
    if text_at is None or file.resolve() == log.path.resolve():
        return log
    text = text_at(file)
    if file.exists() and file.read_text(encoding="utf-8") != text:
        raise SceneError(f"{file}: has other boxes than {log.path}: give another folder")
    write_file(file, text, OutputError)
    moved = copy.copy(log)
    moved.path = file
    return moved


def observe(scene: TorchScene, cameras: Sequence[str], frames: Sequence[int], points: Iterable[FloatArray]) -> Tensor:
    """Mark the voxels that training images and LiDAR returns, parts (N, 3) in the world frame, show, for the mask of what nothing
    recorded supports.

    Those next to them are marked too: a surface on the border of two voxels is in one at one time, in the other at
    another. Returns which voxels (V,) bool, flat, the images look through on the way: nobody saw anything there,
    and it was in view.
    """
    model = scene.model
    seen, through = model.observed.view(-1), torch.zeros_like(model.observed, dtype=torch.bool).view(-1)
    into = invert_pose(model.volume.world_from_volume)
    for part in points:
        seen[model.occupancy.cells(torch.as_tensor(transform_points(into, part)).float().to(seen.device))] = 1
    drive = scene.header.drive
    backend = TorchBackend(scene, QUALITIES["fast"])
    states = DriveStates(drive, backend.parked)
    outlines = outlines_from_json(scene.header.training.get("own_vehicle"))
    for camera in cameras:
        shown = drive.cameras[camera]
        for frame in captures_of(shown.time_s, drive, frames, shown.time_s):
            u, v = pixel_grid(shown.model, max(1, shown.model.width // 96))
            if not shown.model.is_pinhole:
                inside = has_direction(shown.model, u, v)
                u, v = u[inside], v[inside]
            if camera in outlines:
                size = shown.model.width, shown.model.height
                scene_shown = shows_scene(*outlines[camera], u, v, size)
                u, v = u[scene_shown], v[scene_shown]
            time_s = shown.time_s[frame]
            rays = camera_rays(shown, time_s, u, v).flat()
            tracer = backend.bind(states.state(*exposure_window(shown, time_s)))
            with torch.no_grad():
                depth = torch.as_tensor(tracer.trace(rays, {"depth"}, False, None, RenderStats()).maps["depth"]).to(
                    seen.device
                )
                batch = to_batch(rays, model.frame)
                x = model.frame.points(batch.origins + batch.directions * depth[:, None])
                seen[model.occupancy.cells(x[model.frame.inside(x)])] = 1
                for cells in _cells_passed(model, batch, depth - model.config.voxel_m):
                    through[cells] = True
    dilated = F.max_pool3d(model.observed[None, None].float(), 3, stride=1, padding=1)[0, 0]
    model.observed.copy_(dilated)
    return through


def _cells_passed(model: SceneModel, rays: RayBatch, depth_m: Tensor) -> Iterator[Tensor]:
    """Flat voxel numbers that rays come through before depths (N,), a part of the rays at a time."""
    o, d = model.frame.points(rays.origins), model.frame.vectors(rays.directions)
    reach = torch.minimum(depth_m, model.frame.span(o, d, NEAR_M)[1])
    step = model.config.voxel_m / 2
    for part in torch.arange(len(o), device=o.device).split(1024):
        t = (torch.arange(int(reach[part].max().clamp_min(0) / step) + 1, device=o.device) + 0.5) * step
        x = o[part, None] + t[:, None] * d[part, None]
        yield model.occupancy.cells(x[(t < reach[part, None]) & model.frame.inside(x)])


PREVIEW_WIDTH = 240


def refined_drive(trainer: Trainer) -> Drive:
    """The log's drive with the tracklets and camera mounts as training refined them."""
    drive = trainer.log.drive
    positions, quaternions = (t.detach().cpu().double().numpy() for t in trainer.tracklets.keys())
    positions = trainer.tracklets.corner + positions
    actors = dict(drive.actors)
    for i, uid in enumerate(trainer.model.actor_ids if trainer.recipe.refines_tracklets else ()):
        actor = drive.actors[uid]
        k = len(actor.world_from_actor.times_s)
        q = quaternions[i, :k] / np.linalg.norm(quaternions[i, :k], axis=1, keepdims=True)
        actors[uid] = dataclasses.replace(
            actor, world_from_actor=Trajectory(actor.world_from_actor.times_s, positions[i, :k], q)
        )
    cameras = dict(drive.cameras)
    for number, name in enumerate(trainer.config.cameras):
        cameras[name] = trainer.camera_poses.corrected(cameras[name], number)
    return dataclasses.replace(drive, actors=actors, cameras=cameras)


def header_of(trainer: Trainer, out: Path) -> SceneHeader:
    """Return the header to write to `scene.json`."""
    config, log = trainer.config, trainer.log
    training = {
        "preset": config.preset, "method": trainer.recipe.method, "without": list(config.without),
        "cameras": list(config.cameras), "lidars": list(trainer.lidars), "frames": list(config.frames),
        "width": config.width, "iterations": trainer.iteration, "minutes": config.minutes,
        "seconds": round(trainer.elapsed_s, 1), "rays": config.patches * config.patch_cells**2,
        "seed": config.seed, "adversarial": config.adversarial, "device": config.device,
        "own_vehicle": outlines_to_json(trainer.cameras.outlines),
    }  # fmt: skip
    if trainer.recipe.refines_cameras:
        views = trainer.cameras.views
        times_s = [camera.time_s[frame] for _, camera, frame in views]
        gains = trainer.log_gains.detach().double().exp().cpu().numpy()
        training["exposures"] = Exposures.of([c.sensor_id for _, c, _ in views], times_s, gains).to_json()
    if config.noise is not None:
        training["disturbed"] = config.noise
    if (poses := extras_of(log).poses) != "log":
        training["poses"] = poses
    return SceneHeader(
        path=out,
        name=out.name,
        log_name=log.drive.name,
        log_path=os.path.relpath(log.path, out),
        world_origin=log.drive.world_origin,
        model=trainer.model.config.to_dict(),
        volume=trainer.volume.to_dict(),
        drive=refined_drive(trainer),
        training=training,
        fingerprint=trainer.fingerprint,
    )


def _as_scene(trainer: Trainer, out: Path) -> TorchScene:
    with torch.no_grad():
        return TorchScene(out, header_of(trainer, out), trainer.model, trainer.model.actors.tables())


def write_scene(trainer: Trainer, out: Path) -> SceneHeader:
    """Free what was never seen, note which voxels the recording supports, write the scene."""
    for parameter in trainer.model.parameters():
        parameter.grad = None
    scene = _as_scene(trainer, out)
    trainer.model.eval()
    trainer.occupancy.free_unshown()
    through = observe(scene, trainer.config.cameras, trainer.config.frames, trainer.lidar.points_by_sweep())
    if trainer.recipe.weights.unobserved:
        trainer.occupancy.free_unobserved(through, trainer.unobserved.continued)
    header = scene.header
    header.training["accuracy"] = accuracy(TorchBackend(scene, QUALITIES["balanced"]), header, trainer.log)
    save_scene(out, header, trainer.model, cells_to_store)
    return header


ACCURACY_FRAMES, ACCURACY_BEAMS = 4, 4096
"""Largest number of frames of each sensor, and of returns of each sweep, that accuracy is measured in."""


def accuracy(backend: Backend, header: SceneHeader, log: Log) -> dict[str, float]:
    """Return the fractions of pixels ("camera"), by their colour, and of returns ("lidar"), by their distance, that are right
    (`render.confidence`) in frames of the log: where there are some, of those that the scene was not trained on."""
    renderer, training, drive = Renderer(backend), header.training, header.drive
    states, right = states_of(renderer, drive), {"camera": list[float](), "lidar": list[float]()}
    outlines = outlines_from_json(training.get("own_vehicle"))

    def some_of(sensor: Camera | Lidar, there: Sequence[int]) -> Iterator[int]:
        trained = set(captures_of(sensor.time_s, drive, training["frames"], there))
        frames = [frame for frame in there if frame not in trained] or list(there)
        yield from frames[:: -(-len(frames) // ACCURACY_FRAMES) or 1]

    for name in training["cameras"]:
        for frame in some_of(drive.cameras[name], log.image_frames(name)):
            with suppress(LogError):  # a frame that was not trained on may be damaged
                image, recorded = _rendered_and_recorded(renderer, states, log, name, frame)
                model = image.model
                is_right = (np.abs(image.rgb - recorded / np.float32(255)) < RIGHT_RGB).all(-1)
                shown = shown_pixels(log.drive.cameras[name].model, model)
                shown = np.ones_like(is_right) if shown is None else shown
                if name in outlines:
                    shown = shown & shows_scene(*outlines[name], *pixel_grid(model), (model.width, model.height))
                right["camera"].append(float(is_right[shown].mean()))
    for name in training["lidars"]:
        for frame in some_of(drive.lidars[name], log.sweep_frames(name)):
            with suppress(LogError):
                beams = known_rays(log, name, frame)
                some = np.flatnonzero(beams.returned)
                some = some[:: -(-len(some) // ACCURACY_BEAMS) or 1]
                times, known = beams.time_s[some], beams.depth_m[some]
                rays = Rays(beams.origins[some], beams.directions[some], times)
                state = states.states.state(float(times.min()), float(times.max()))
                depth, _, probability, _ = renderer.beams(state, rays, drive.lidars[name])
                close = np.abs(depth - known) <= np.maximum(TOLERANCE_M, TOLERANCE * known)
                right["lidar"].append(float((close & (probability >= 0.5)).mean()))
    return {kind: round(float(np.mean(shares)), 4) for kind, shares in right.items() if shares}


def preview_frame(trainer: Trainer) -> tuple[str, int]:
    """Camera and frame of the preview: of the first camera the middle frame that is not trained on, or
    else the middle one."""
    config = trainer.config
    frames = trainer.log.image_frames(config.cameras[0])
    held_out = [frame for frame in frames if frame not in config.frames] or list(frames)
    return config.cameras[0], held_out[len(held_out) // 2]


def _rendered_and_recorded(
    renderer: Renderer, states: CaptureStates, log: Log, name: str, frame: int
) -> tuple[CameraFrame, NDArray[np.uint8]]:
    """Return a small image of a recorded frame, rendered and as it was recorded (H, W, 3)."""
    recorded, camera = log.image(name, frame), states.camera(name)
    width = min(PREVIEW_WIDTH, camera.model.width)
    rendered = render_image(renderer, states, Capture.of_frame(camera, frame), width=width)
    return rendered, resize_image(recorded, rendered.model)


def preview(trainer: Trainer, file: Path) -> None:
    """Write a small image: recorded beside rendered. It changes nothing of the training."""
    name, frame = preview_frame(trainer)
    trainer.model.eval()
    scene = _as_scene(trainer, file.parent)
    renderer = Renderer(TorchBackend(scene, QUALITIES["fast"]))
    states = states_of(renderer, scene.header.drive)
    rendered, recorded = _rendered_and_recorded(renderer, states, trainer.log, name, frame)
    trainer.model.train()
    both = np.concatenate([recorded, np.round(rendered.rgb * 255).astype(np.uint8)], 1)
    temporary = file.with_name(f".{file.name}")
    Image.fromarray(both).save(temporary, format="png")
    os.replace(temporary, file)
