"""Batches that are drawn on the device that trains: images, lenses, trajectories and sweeps lie there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...model.tracklets import interpolated
from ...ops.ray_segments import RayBatch
from ...sensors.camera import line_count, pixel_directions
from ...sensors.unprojection import has_direction
from ...world.replay import PaddedKeys
from .data import CameraData, LidarData, PatchBatch
from .images import ERROR_DECAY, EVEN, PixelChoice
from .sweeps import LidarBatch, drawn_of_actors


def _one_after_the_other(parts: Sequence[NDArray[Any]], device: str) -> tuple[Tensor, Tensor]:
    """Return arrays in one tensor on a device, and where each begins (N,)."""
    begins = np.cumsum([0, *(len(part) for part in parts)])[:-1]
    return torch.as_tensor(np.concatenate(parts)).to(device), torch.as_tensor(begins).to(device)


class DeviceSweeps:
    """The rays of `LidarData`."""

    def __init__(self, lidar: LidarData, device: str) -> None:
        arrays = lidar.origins, lidar.directions, lidar.depth_m, lidar.intensity
        self.origins, self.directions, self.depth_m, self.intensity = (
            torch.as_tensor(array.astype(np.float32)).to(device) for array in arrays
        )
        self.time_s, self.returned = (torch.as_tensor(array).to(device) for array in (lidar.time_s, lidar.returned))
        marks = lidar.returned, ~lidar.returned
        self.hits, self.drops = (torch.as_tensor(np.flatnonzero(mark)).to(device) for mark in marks)
        self.of_actors = torch.as_tensor(lidar.of_actors).to(device)

    def sample(self, count: int, drops: float = 0.15) -> LidarBatch:
        """`LidarData.sample` by the device's own random numbers."""
        n_drops = int(count * drops) if len(self.drops) else 0
        n_own = int((count - n_drops) * drawn_of_actors(len(self.of_actors), len(self.hits)))
        kinds = ((self.hits, count - n_drops - n_own), (self.of_actors, n_own), (self.drops, n_drops))
        index = torch.cat(
            [rows[torch.randint(len(rows), (number,), device=rows.device)] for rows, number in kinds if number]
        )
        share, returned = len(self.drops) / len(self.returned), self.returned[index]
        hit, drop = (1 - share) / (1 - n_drops / count), share * count / n_drops if n_drops else 0.0
        rays = RayBatch(self.origins[index], self.directions[index], self.time_s[index])
        return LidarBatch(
            rays, self.depth_m[index], self.intensity[index], returned, drop + (hit - drop) * returned.float()
        )


class DeviceImages:
    """The images of `CameraData` and the choice of their pixels, for feature cells of ``up`` pixels along an edge and
    patches of ``cells`` cells along one.

    A lens is a table of unit directions, camera frame, at all points where the middle of a cell can lie. Where images
    show no part of the vehicle itself and the lens shows enough, corners of patches are listed for each camera.
    """

    def __init__(self, cameras: CameraData, choice: PixelChoice, cells: int, up: int, device: str) -> None:
        self.cells, self.up, self.offset = cells, up, 0.5 * (up % 2)
        models = [camera.model for camera in cameras.cameras.values()]
        grids = [np.mgrid[: m.height + 1, : m.width + 1].reshape(2, -1) + self.offset for m in models]
        lens = [pixel_directions(m, u, v).astype(np.float32) for m, (v, u) in zip(models, grids, strict=True)]
        self.lens, self.first_direction = _one_after_the_other([np.nan_to_num(part) for part in lens], device)
        corners = [cameras.corners(name, cells * up) for name in cameras.cameras]
        self.corner, self.first_corner = _one_after_the_other(corners, device)
        images = [cameras.images.image(view).reshape(-1, 3) for view in range(len(cameras.views))]
        self.pixels, self.first_pixel = _one_after_the_other(images, device)
        self.shown: tuple[Tensor, Tensor, Tensor] | None = None
        if any(mask is not None for mask in cameras.shown.values()):
            masks = zip(models, cameras.shown.values(), strict=True)
            marks = [np.ones(m.height * m.width, bool) if mask is None else mask.ravel() for m, mask in masks]
            known = [has_direction(m, u, v) for m, (v, u) in zip(models, grids, strict=True)]
            self.shown = *_one_after_the_other(marks, device), _one_after_the_other(known, device)[0]

        def tensor(values: Any) -> Tensor:
            return torch.as_tensor(np.asarray(values)).to(device)

        self.corners, self.width = tensor([len(part) for part in corners]), tensor([m.width for m in models])
        self.by_column = tensor([m.shutter.axis == "columns" for m in models])
        self.lines = tensor([float(line_count(m)) for m in models])
        self.reference = tensor([float(m.shutter.reference) for m in models])
        self.camera = tensor([number for number, _, _ in cameras.views])
        self.time_s = tensor([camera.time_s[frame] for _, camera, frame in cameras.views])
        shutters = [camera.model_at(camera.time_s[frame]).shutter for _, camera, frame in cameras.views]
        self.duration_s = tensor([float(shutter.duration_s) for shutter in shutters])
        keys = PaddedKeys.of_trajectories([camera.world_from_camera for camera in cameras.cameras.values()])
        self.times_s, self.lengths = tensor(keys.times_s), tensor(keys.lengths).long()
        self.keys = tensor((keys.positions - cameras.corner).astype(np.float32)), tensor(keys.quaternions_wxyz).float()
        blocks = choice.view, choice.x, choice.y, choice.width, choice.height
        self.view, self.x, self.y, self.columns, self.rows = (tensor(values) for values in blocks)
        self.even, self.error = tensor(choice.even), choice.to(device)

    def patches(self, count: int) -> PatchBatch:
        """`CameraData.patches` by the device's own random numbers."""
        view = torch.randint(len(self.camera), (count,), device=self.camera.device)
        camera = self.camera[view]
        draw = torch.rand(count, dtype=torch.float64, device=camera.device) * self.corners[camera]
        place = self.corner[self.first_corner[camera] + torch.minimum(draw.long(), self.corners[camera] - 1)].long()
        columns = self.width[camera] - self.cells * self.up + 1
        return self.batch(view, place % columns, torch.div(place, columns, rounding_mode="floor"), self.cells)

    def scattered(self, count: int) -> tuple[PatchBatch, Tensor, Tensor]:
        """Single cells, drawn as `PixelChoice.draw` does; the block (N,) that each lies in and its weight (N,)."""
        large = self.even * self.error
        chance = EVEN * self.even + (1 - EVEN) / large.sum() * large
        ends, device = chance.cumsum(0), chance.device
        random = torch.rand(3, count, dtype=torch.float64, device=device)
        block = torch.searchsorted(ends, random[0] * ends[-1], right=True).clamp_max(len(ends) - 1)
        x = self.x[block] + (random[1] * self.columns[block]).long()
        y = self.y[block] + (random[2] * self.rows[block]).long()
        return self.batch(self.view[block], x, y, 1), block, (self.even[block] / chance[block]).float()

    def note(self, block: Tensor, square: Tensor) -> None:
        """`PixelChoice.note` of squared errors (N,) in blocks (N,)."""
        sums = torch.zeros(2, len(self.error), dtype=torch.float64, device=block.device)
        sums.index_add_(1, block, torch.stack([torch.ones_like(square), square]).double())
        decay = ERROR_DECAY ** sums[0]
        self.error.copy_(torch.sqrt(decay * self.error**2 + (1 - decay) * sums[1] / sums[0].clamp_min(1)))

    def batch(self, view: Tensor, x: Tensor, y: Tensor, cells: int) -> PatchBatch:
        """Return patches of cells x cells cells of images ``view`` (B,), whose upper left corners are at columns x and
        rows y (B,)."""
        edge, device, camera = cells * self.up, view.device, self.camera[view]
        centre = torch.arange(cells, device=device) * self.up + self.up // 2
        row, column = (y[:, None, None] + centre[:, None]).expand(-1, -1, cells), x[:, None, None] + centre
        column = column.expand_as(row)
        at = (self.first_direction[camera])[:, None, None] + row * (self.width[camera] + 1)[:, None, None] + column
        line = torch.where(self.by_column[camera][:, None, None], column, row).flatten(1) + self.offset
        part = line.double() / self.lines[camera][:, None] - self.reference[camera][:, None]
        time_s = (self.time_s[view][:, None] + self.duration_s[view][:, None] * part).flatten()
        each = camera.repeat_interleave(cells * cells)
        origins, rotation = interpolated(self.times_s, self.lengths, self.keys, each, time_s)
        directions = torch.einsum("nij,nj->ni", rotation, self.lens[at.flatten()])
        _, turned = interpolated(self.times_s, self.lengths, self.keys, camera, self.time_s[view])
        pixel = torch.arange(edge, device=device)
        inside = (y[:, None, None] + pixel[:, None]) * self.width[camera][:, None, None] + x[:, None, None] + pixel
        target = self.pixels[self.first_pixel[view][:, None, None] + inside].permute(0, 3, 1, 2).float() / 255
        shown = None
        if self.shown is not None and cells > 1:
            marks, first, known = self.shown
            of_cells = known[at].repeat_interleave(self.up, 1).repeat_interleave(self.up, 2)
            shown = (marks[first[camera][:, None, None] + inside] & of_cells)[:, None].float()
        return PatchBatch(RayBatch(origins, directions, time_s), camera, view, target, turned, cells, shown)


def device_bytes(cameras: CameraData, lidar: LidarData) -> int:
    """Return about how many bytes of a device's memory the batches' data take."""
    pixels = [camera.model.width * camera.model.height for _, camera, _ in cameras.views]
    lenses = [camera.model.width * camera.model.height for camera in cameras.cameras.values()]
    return 3 * sum(pixels) + 20 * sum(lenses) + 41 * len(lidar.returned)
