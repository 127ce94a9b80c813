"""Hits of a sensor's rays on meshes, and the meshes' appearance there.

Several rays go through each pixel of an image, so that a mesh's outline is as smooth as the recorded image. The
fraction of a cell that they cover is the mesh's opacity on the cell's ray, by which it is composited with the fields.
Normals and colours are interpolated at a hit, and lit by a simple model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb, srgb_from_linear
from ..geometry import BoolArray, FloatArray
from ..sensors.camera import camera_rays
from ..sensors.rays import Rays
from ..sensors.unprojection import least_pixels_per_rad
from ..world.drive import Actor, Camera, Lidar
from .intersect import FirstHits, Mesh, first_hits_on, normals_of, ready
from .model import MeshModel
from .read import read_mesh

SKY, SUN = 0.65, 0.35
"""Fractions of the light on level ground that come from the sky and from the sun."""
TO_SUN = np.array([0.42, 0.32, 0.85]) / np.linalg.norm([0.42, 0.32, 0.85])
"""Assumed unit direction (3,) to the sun, world frame: from above, slightly from one side, so that a body's faces
differ."""
_LINEAR = linear_from_srgb(np.arange(256, dtype=np.float32) / 255)


def normals_at(model: MeshModel, hits: FirstHits, directions: FloatArray) -> FloatArray:
    """Return unit normals (N, 3) of hits, in the model's axes, on the side that rays of directions (N, 3) come from."""
    normal = _at(model.normals, hits).astype(np.float64)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 1e-6, normal / np.where(length > 1e-6, length, 1.0), -directions)
    return np.asarray(np.where((normal * directions).sum(1, keepdims=True) > 0, -normal, normal))


def colours_at(model: MeshModel, hits: FirstHits) -> FloatArray:
    """Return colours (N, 3) of the surface at hits, linear Rec.709 in 0..1."""
    colours = _at(model.colours, hits).astype(np.float64)
    texture = model.texture[hits.face]
    for i, image in enumerate(model.textures):
        mine = texture == i
        if mine.any():
            uv = _at(model.uv, FirstHits(hits.t[mine], hits.face[mine], hits.uv[mine]))
            colours[mine] *= _bilinear(image, uv)
    return colours


def lit(colours: FloatArray, normals: FloatArray, level: FloatArray) -> FloatArray:
    """Return the linear brightness (N, 3) of surfaces of linear ``colours`` (N, 3) with unit ``normals`` (N, 3), world
    frame, under a sky and a sun without shadows, where white level ground has brightness ``level`` (N, 3), or
    (1, 3) for all."""
    assert colours.shape == normals.shape, (colours.shape, normals.shape)
    assert level.shape in (colours.shape, (1, 3)), (colours.shape, level.shape)
    sky = SKY * (1 + normals[:, 2]) / 2
    sun = SUN * np.maximum(normals @ TO_SUN, 0) / TO_SUN[2]
    return np.asarray(colours * level * (sky + sun)[:, None])


def reflectivity(colours: FloatArray, cosine: FloatArray) -> FloatArray:
    """Return the LiDAR intensity (N,) in 0..1 of matt surfaces of linear ``colours`` (N, 3), hit at angles of incidence
    with ``cosine`` (N,)."""
    assert colours.shape == (*cosine.shape, 3), (colours.shape, cosine.shape)
    return np.asarray(np.clip(colours @ np.array([0.2126, 0.7152, 0.0722]) * np.abs(cosine), 0, 1))


def _at(values: NDArray[np.float32], hits: FirstHits) -> NDArray[np.float32]:
    """Return values (F, 3, C) of faces' corners between them: (N, C)."""
    u, v = hits.uv[:, :1], hits.uv[:, 1:]
    a, b, c = (values[hits.face, k] for k in range(3))
    return np.asarray(a * (1 - u - v) + b * u + c * v)


def _bilinear(image: NDArray[np.uint8], uv: NDArray[np.float32]) -> FloatArray:
    """Return a texture's linear colours (N, 3) at uv (N, 2), repeated beyond its edges."""
    height, width = image.shape[:2]
    x, y = uv[:, 0] * width - 0.5, (1 - uv[:, 1]) * height - 0.5
    column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    right, down = (x - column)[:, None], (y - row)[:, None]

    def texel(r: NDArray[np.int64], c: NDArray[np.int64]) -> NDArray[np.float32]:
        return _LINEAR[image[r % height, c % width]]

    top = texel(row, column) * (1 - right) + texel(row, column + 1) * right
    bottom = texel(row + 1, column) * (1 - right) + texel(row + 1, column + 1) * right
    return np.asarray(top * (1 - down) + bottom * down, np.float64)


SIDE = 3
"""Edge of the square of rays that go through a pixel."""
CHUNK_RAYS = 1 << 18
Level = Callable[[Actor], FloatArray]
"""Function from an actor to the linear brightness (3,) of white level ground under it."""


@dataclass(frozen=True)
class MeshHits:
    """Rays that hit a mesh: their numbers ray (P,), ascending; t (P,), metres; share (P,) in 0..1 of the ray that the
    mesh covers; unit normals (P, 3), world frame; actor (P,), its index among the mesh actors. For a camera ``pixels``
    (P, up, up, 4): linear colour of the cell's pixels and the fraction of each that the mesh covers; for a LiDAR
    ``intensity`` (P,) in 0..1."""

    ray: NDArray[np.int64]
    t: FloatArray
    share: FloatArray
    normals: FloatArray
    actor: NDArray[np.int64]
    pixels: NDArray[np.float32] | None = None
    intensity: FloatArray | None = None

    def between(self, begin: int, end: int) -> MeshHits:
        """Return the hits of rays ``begin`` to ``end`` (exclusive), numbered from ``begin``."""
        first, last = np.searchsorted(self.ray, [begin, end])
        return MeshHits(
            self.ray[first:last] - begin,
            self.t[first:last],
            self.share[first:last],
            self.normals[first:last],
            self.actor[first:last],
        )

    def over(
        self, image: NDArray[np.float32], stopped: NDArray[np.float32], shape: tuple[int, ...]
    ) -> NDArray[np.float32]:
        """Return the image (H, W, 3), display-referred sRGB, of cells in ``shape`` (h, w), with the meshes blended over
        it. ``stopped`` (h w,) is their opacity on each cell's ray: less than the covered share where something is in
        front."""
        assert self.pixels is not None
        up = self.pixels.shape[1]
        layer = np.zeros((*shape, up, up, 4), np.float32).reshape(-1, up, up, 4)
        seen = np.clip(stopped[self.ray] / np.maximum(self.share, 1e-6), 0, 1)
        layer[self.ray, ..., :3] = srgb_from_linear(self.pixels[..., :3])
        layer[self.ray, ..., 3] = self.pixels[..., 3] * seen[:, None, None]
        layer = layer.reshape(*shape, up, up, 4).swapaxes(1, 2).reshape(shape[0] * up, shape[1] * up, 4)
        layer = layer[: image.shape[0], : image.shape[1]]
        return image + layer[..., 3:] * (layer[..., :3] - image)


class MeshActors:
    """Actors that are meshes; bodies of the ego vehicle come last."""

    def __init__(self, actors: Sequence[Actor]) -> None:
        self.actors = tuple(actors)

    @property
    def uids(self) -> tuple[str, ...]:
        return tuple(actor.uid for actor in self.actors)

    def seen_by(self, sensor: Camera | Lidar) -> MeshActors:
        """Return the mesh actors that a sensor can see; each has the same number as among all."""
        return self if sensor.sees_ego_body else self._without_bodies

    @cached_property
    def _without_bodies(self) -> MeshActors:
        others = [actor for actor in self.actors if not actor.is_ego_body]
        return self if len(others) == len(self.actors) else MeshActors(others)

    @cached_property
    def meshes(self) -> list[Mesh]:
        """Their meshes; one for all that share a file."""
        return [ready(read_mesh(Path(actor.appearance.mesh))) for actor in self.actors]

    def hit_by_camera(
        self,
        camera: Camera,
        time_s: float,
        cells: tuple[FloatArray, FloatArray],
        centres: Rays,
        up: int,
        near_m: float,
        level: Level,
    ) -> MeshHits | None:
        """Return the mesh hits in ``cells`` of ``up`` x ``up`` pixels with centres (u, v) (h, w), and rays (h w,)
        through those; None where there are none."""
        if not self.actors:
            return None
        u, v = cells
        near = np.flatnonzero(self._near(centres, 2.0 * up / least_pixels_per_rad(camera.model)))
        side = up * SIDE
        offset = ((np.arange(side) + 0.5) / side - 0.5) * up
        chunks = []
        step = max(1, CHUNK_RAYS // side**2)
        levels: dict[int, FloatArray] = {}
        for begin in range(0, len(near), step):
            part = near[begin : begin + step]
            shape = len(part), side, side
            us = np.broadcast_to(u.reshape(-1)[part, None, None] + offset, shape)
            vs = np.broadcast_to(v.reshape(-1)[part, None, None] + offset[:, None], shape)
            rays = camera_rays(camera, time_s, us, vs).flat()
            t, actor, normals, colours = self._first(rays, near_m)
            hit = actor >= 0
            for i in set(actor[hit].tolist()) - set(levels):
                levels[i] = level(self.actors[i])
            light = np.zeros((len(actor), 3))
            if hit.any():
                table = np.stack([levels.get(i, np.zeros(3)) for i in range(len(self.actors))])
                light[hit] = lit(colours[hit], normals[hit], table[actor[hit]])
            chunks.append(_cell_means(part, up, hit, t, actor, normals, np.clip(light, 0, 1)))
        return _joined(chunks)

    def hit_by_rays(self, rays: Rays, near_m: float) -> MeshHits | None:
        """Return the mesh hits of single rays (N, 3), (N, 3), (N,), such as a LiDAR's beams; None where there are
        none."""
        if not self.actors:
            return None
        near = np.flatnonzero(self._near(rays, 0.0))
        part = rays.part(near)
        t, actor, normals, colours = self._first(part, near_m)
        hit = actor >= 0
        if not hit.any():
            return None
        cosine = (normals[hit] * part.directions[hit]).sum(1)
        intensity = reflectivity(colours[hit], cosine)
        return MeshHits(near[hit], t[hit], np.ones(hit.sum()), normals[hit], actor[hit], intensity=intensity)

    def _near(self, rays: Rays, widening: float) -> BoolArray:
        """Return which rays (N,) enter the sphere around some mesh's box, wider by ``widening`` for each metre of
        distance."""
        times, which = moments(rays)
        near = np.zeros(len(which), bool)
        for actor in self.actors:
            near |= near_actor(actor, actor.world_from_actor.at(times), which, rays, widening)
        return near

    def _first(self, rays: Rays, near_m: float) -> tuple[FloatArray, NDArray[np.int64], FloatArray, FloatArray]:
        """Return t (N,), actor (N,) or -1, normals (N, 3) world frame, colours (N, 3) linear, of the first mesh on each
        ray."""
        times, which = moments(rays)
        n = len(which)
        t, owner = np.full(n, np.inf), np.full(n, -1)
        normals, colours = np.zeros((n, 3)), np.zeros((n, 3))
        for i, (actor, mesh) in enumerate(zip(self.actors, self.meshes, strict=True)):
            poses = actor.world_from_actor.at(times)
            mine = np.flatnonzero(near_actor(actor, poses, which, rays, 0.0))
            if len(mine) == 0:
                continue
            pose = poses[which[mine]]
            hits, d = first_hits_on(actor, mesh, pose, rays.origins[mine], rays.directions[mine], near_m)
            first = (hits.face >= 0) & (hits.t < t[mine])
            hits, at = FirstHits(hits.t[first], hits.face[first], hits.uv[first]), mine[first]
            t[at], owner[at] = hits.t, i
            normals[at] = normals_of(actor, pose[first], normals_at(mesh.model, hits, d[first]))
            colours[at] = colours_at(mesh.model, hits)
        return t, owner, normals, colours


def moments(rays: Rays) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the different times (T,) of rays, and the index (N,) of each ray's time: rays of a row or column share
    theirs."""
    times, which = np.unique(rays.time_s, return_inverse=True)
    return times, which.reshape(-1)


def near_actor(actor: Actor, poses: FloatArray, which: NDArray[np.int64], rays: Rays, widening: float) -> BoolArray:
    """Return which rays (N,) come near one actor, whose poses (T, 4, 4) are those of the rays' different times, of
    index ``which`` (N,)."""
    present = actor.present(rays.time_s)
    to = poses[which, :3, 3] - rays.origins
    along = np.einsum("ij,ij->i", to, rays.directions)
    reach = np.linalg.norm(actor.size_m) / 2 + widening * np.maximum(along, 0) + 1e-3
    squared = np.einsum("ij,ij->i", to, to)
    return np.asarray(present & (squared - np.maximum(along, 0) ** 2 <= reach * reach))


def _cell_means(
    cells: NDArray[np.int64],
    up: int,
    hit: BoolArray,
    t: FloatArray,
    actor: NDArray[np.int64],
    normals: FloatArray,
    light: FloatArray,
) -> MeshHits:
    """Return one entry for each cell, of the hits of its rays (cells * side * side,); cells without any are left
    out."""
    per_cell = (len(cells), (up * SIDE) ** 2)
    hits = hit.reshape(per_cell)
    some = hits.any(1)
    first = t.reshape(per_cell).argmin(1)
    owner = np.take_along_axis(actor.reshape(per_cell), first[:, None], 1)
    own = hits & (actor.reshape(per_cell) == owner)
    count = np.maximum(own.sum(1), 1)
    depth = np.where(own, t.reshape(per_cell), 0.0).sum(1) / count
    mean = np.where(own[..., None], normals.reshape(*per_cell, 3), 0.0).sum(1)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-9)
    fine = (len(cells), up, SIDE, up, SIDE)
    covered = hit.reshape(fine).mean((2, 4))
    shown = np.where(hit[:, None], light, 0.0).reshape(*fine, 3).mean((2, 4)) / np.maximum(covered, 1e-9)[..., None]
    pixels = np.concatenate([shown, covered[..., None]], -1).astype(np.float32)
    return MeshHits(cells[some], depth[some], hits.mean(1)[some], mean[some], owner[some, 0], pixels[some])


def _joined(chunks: Sequence[MeshHits]) -> MeshHits | None:
    chunks = [mesh_hits for mesh_hits in chunks if len(mesh_hits.ray)]
    if not chunks:
        return None
    pixels = np.concatenate([mesh_hits.pixels for mesh_hits in chunks if mesh_hits.pixels is not None])
    ray, t, share, normals, actor = (
        np.concatenate(column)
        for column in zip(*((m.ray, m.t, m.share, m.normals, m.actor) for m in chunks), strict=True)
    )
    return MeshHits(ray, t, share, normals, actor, pixels)
