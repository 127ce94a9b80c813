"""What a recording shows of a scene: the voxels that its images and LiDAR returns end in, and those that
they look through."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from ...data.own_vehicle import outlines_from_json, shows_scene
from ...geometry import FloatArray, invert_pose, transform_points
from ...model.files.checkpoint import TorchScene
from ...model.scene import SceneModel
from ...ops.ray_segments import RayBatch
from ...render.quality import QUALITY
from ...render.tracer import NEAR_M
from ...render.tracers.torch.tracer import TorchBackend, to_batch
from ...sensors.camera import camera_rays, pixel_grid
from ...sensors.exposure import exposure_window
from ...sensors.frames import RenderStats
from ...sensors.unprojection import has_direction
from ...world.own_rates import captures_of
from ...world.replay import DriveStates


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
    backend = TorchBackend(scene, QUALITY["fast"])
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
