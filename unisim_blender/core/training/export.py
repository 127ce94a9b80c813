"""What a training leaves for others: the finished scene, its header, and previews on the way."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from ..data.images import resize_image
from ..data.own_vehicle import outlines_to_json
from ..geometry import Trajectory
from ..model.files.checkpoint import TorchScene, save_scene
from ..model.files.scene_file import SceneHeader
from ..render.captures import render_image, states_of
from ..render.quality import QUALITY
from ..render.renderer import Renderer
from ..render.tracers.compiled.scene import cells_to_store
from ..render.tracers.torch.tracer import TorchBackend
from ..world.captures import Capture
from ..world.drive import Drive
from .space.observed import observe
from .trainer import Trainer

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
    """What `scene.json` is to say."""
    config, log = trainer.config, trainer.log
    training = {
        "preset": config.preset, "method": trainer.recipe.method, "without": list(config.without),
        "cameras": list(config.cameras), "lidars": list(trainer.lidars), "frames": list(config.frames),
        "width": config.width, "iterations": trainer.iteration, "minutes": config.minutes,
        "seconds": round(trainer.elapsed_s, 1), "rays": config.patches * config.patch_cells**2,
        "seed": config.seed, "adversarial": config.adversarial, "device": config.device,
        "own_vehicle": outlines_to_json(trainer.cameras.outlines),
    }  # fmt: skip
    if config.noise is not None:
        training["disturbed"] = config.noise
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


def finish(trainer: Trainer, out: Path) -> SceneHeader:
    """Free what was never seen, note which voxels the recording supports, write the scene."""
    for parameter in trainer.model.parameters():
        parameter.grad = None
    scene = _as_scene(trainer, out)
    trainer.model.eval()
    trainer.occupancy.free_unshown()
    through = observe(scene, trainer.config.cameras, trainer.config.frames, trainer.lidar.points_by_sweep())
    if trainer.recipe.weights.unobserved:
        trainer.occupancy.free_unobserved(through, trainer.unobserved.continued)
    save_scene(out, scene.header, trainer.model, cells_to_store)
    return scene.header


def preview_frame(trainer: Trainer) -> tuple[str, int]:
    """Camera and frame of the preview: of the first camera the middle frame that is not trained on, or
    else the middle one."""
    config = trainer.config
    frames = trainer.log.image_frames(config.cameras[0])
    held_out = [frame for frame in frames if frame not in config.frames] or list(frames)
    return config.cameras[0], held_out[len(held_out) // 2]


def preview(trainer: Trainer, file: Path) -> None:
    """Write a small image: recorded beside rendered. It changes nothing of the training."""
    name, frame = preview_frame(trainer)
    width = min(PREVIEW_WIDTH, trainer.cameras.cameras[name].model.width)
    trainer.model.eval()
    scene = _as_scene(trainer, file.parent)
    renderer = Renderer(TorchBackend(scene, QUALITY["fast"]))
    states = states_of(renderer, scene.header.drive)
    rendered = render_image(renderer, states, Capture.of_frame(states.camera(name), frame), width=width)
    trainer.model.train()
    recorded = resize_image(trainer.log.image(name, frame), rendered.model)
    both = np.concatenate([recorded, np.round(rendered.rgb * 255).astype(np.uint8)], 1)
    temporary = file.with_name(f".{file.name}")
    Image.fromarray(both).save(temporary, format="png")
    os.replace(temporary, file)
