"""The render path: rays → trace (march, fields, composite) → decode → a frame.

camera_rays / lidar_rays   which rays, when, from where            sensors/
met_by_camera, met_by_rays where rays meet meshes                  meshes/
trace                      samples, fields, depth order, features  trace.py, march.py, fields/, density.py, composite.py
ray_passes                 depth, normal, instance, support        passes.py
ray_head, camera_decoder   features to pixels                      decode.py
lidar_head                 features to intensity and returns       decode.py
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from .bounds import Bounds
from .cast import gather_cast
from .cast_tensors import cast_tensors
from .contact_shadow import shaded
from .devices import tensor_to
from .drive import Actor, Camera, Drive, Lidar
from .errors import SceneError
from .fields.checkpoint import Scene
from .fields.scene import SceneModel
from .frames import CameraFrame, LidarFrame, RenderStats
from .geometry import FloatArray, invert_pose, transform_points
from .meshes.exposure import PROBE_M, beside, level_of
from .meshes.meeting import Met
from .own_vehicle import outlines_from_json, shows_scene
from .passes import fill_passes
from .ray_passes import ray_passes
from .sensors.camera import camera_rays, pixel_grid
from .sensors.lidar import lidar_rays
from .sensors.rays import Rays
from .strands import RayBatch, Traced
from .trace import NEAR_M, Sampling, trace
from .tracer import Maps

QUALITY = {"fast": 0.67, "balanced": 1.0, "reference": 4.0}
"""Samples along a ray, beside the scene's own number."""
CHUNK_RAYS = 16384
EDGE_CELLS = 8
"""How far past its edges a guest is carried on, for the decoder to look at."""
UNIFORM_STEP_M = 0.2
"""What saved samples are counted beside: a march through the volume in steps of this length."""


class Region(NamedTuple):
    """Part of an image, in pixels from its top left corner; ``right`` and ``bottom`` are the first that do not belong to it."""

    left: int
    top: int
    right: int
    bottom: int

    def cells(self, size: int, reach: int, whole: Region) -> tuple[slice, slice]:
        """Rows and columns of the cells of ``size`` pixels that the region touches, and ``reach`` more on every side."""
        spans = ((self.top, self.bottom, whole.bottom), (self.left, self.right, whole.right))
        return tuple(slice(max(0, a // size - reach), min(-(-end // size), -(-b // size) + reach)) for a, b, end in spans)  # type: ignore[return-value]

    def within(self, cells: tuple[slice, slice], size: int) -> tuple[slice, slice]:
        """Where the region lies in the pixels of such cells."""
        rows, columns = (c.start * size for c in cells)
        return slice(self.top - rows, self.bottom - rows), slice(self.left - columns, self.right - columns)


class Renderer:
    """Renders a drive with a trained scene. ``others`` are scenes by path, for actors that come from them; ``draw`` seeds the
    draw of the beams that return, which without it are those whose probability is half or more. ``shadows`` puts contact shadows
    under actors that the recording does not have."""

    def __init__(
        self,
        scene: Scene,
        drive: Drive,
        quality: str = "balanced",
        others: dict[str, Scene] | None = None,
        draw: int | None = None,
        shadows: bool = False,
    ) -> None:
        if quality not in QUALITY:
            raise SceneError(f"no quality {quality!r}: there are {', '.join(QUALITY)}")
        self.scene, self.drive, self.draw = scene, drive, draw
        self.device = scene.actor_tables.device
        scenes = {path: (s.model, s.actor_tables) for path, s in {"": scene, **(others or {})}.items()}
        self.who = gather_cast(drive, scene.header.drive, {path: tuple(model.actor_ids) for path, (model, _) in scenes.items()})
        self.cast = cast_tensors(self.who, scenes, self.device)
        self.bounds = Bounds(self.who.own.actors)
        self.sampling = Sampling(fine=QUALITY[quality])
        self.shaders = [actor for actor in drive.actors.values() if actor.inserted] if shadows else []

    @torch.no_grad()
    def camera(
        self,
        camera_id: str,
        frame: int,
        passes: Sequence[str] = ("rgb",),
        width: int | None = None,
        region: Region | None = None,
    ) -> CameraFrame:
        """One image with the passes asked for, or the ``region`` of it: the frame's arrays are then as large as that."""
        begun = time.perf_counter()
        recorded = _pick(self.drive.cameras, camera_id, "camera")
        model = recorded.model.resized(width) if width else recorded.model
        camera = Camera(camera_id, model, recorded.world_from_camera, recorded.time_s)
        up = self.scene.model.config.upsample
        whole = Region(0, 0, model.width, model.height)
        region = whole if region is None else region
        # what the decoder looks at beside the region is traced with it
        reach = self.scene.model.camera_decoder.reach + (EDGE_CELLS if self.cast.guests else 0)
        cells = region.cells(up, reach, whole)
        u, v = (x[cells] for x in pixel_grid(model, up))
        rays = camera_rays(camera, frame, u, v)
        stats = RenderStats()
        needed = {*passes, "depth", "instance"} if self.shaders else set(passes)
        flat = rays.flat()
        met = self.who.extras.met_by_camera(camera, frame, (u, v), flat, up, NEAR_M, partial(self._light, camera, frame))
        traced, maps = self._trace(flat, needed, stats, sky=True, met=met)
        traced_s = time.perf_counter()
        image = self._decode(traced, rays.directions, camera_id, u.shape)
        if met is not None and traced.mesh_opacity is not None:
            image = met.over(image, traced.mesh_opacity.cpu().numpy(), u.shape)
        if self.shaders:
            image = self._shaded(image, rays, maps, camera.time_s[frame])
            maps = {name: values for name, values in maps.items() if name in passes or (name == "depth" and "normal" in passes)}
        stats.seconds = {"trace": traced_s - begun, "decode": time.perf_counter() - traced_s}
        pose = camera.world_from_camera.at(camera.time_s[frame])
        inner = region.within(cells, up)
        out = CameraFrame(model, pose, image[inner], instances=self.who.uids, stats=stats)
        fill_passes(out, maps, rays, u.shape, up, inner)
        return out

    def _light(self, camera: Camera, frame: int, actor: Actor) -> FloatArray:
        """How bright white ground under an actor would be (3,), linear: by the ground beside it, as the camera shows that."""
        time_s = camera.time_s[frame]
        points = beside(actor, time_s)
        ground, frame_of = self.scene.model.ground, self.scene.model.frame
        local = frame_of.points(torch.as_tensor(points, dtype=torch.float32, device=self.device))
        points[:, 2] -= (local[:, 2] - ground.height(local)).double().cpu().numpy()
        to = points - camera.world_from_camera.at(time_s)[:3, 3]
        distance = np.linalg.norm(to, axis=1, keepdims=True)
        directions = to / distance
        rays = Rays(points - directions * np.minimum(distance, PROBE_M), directions, np.full(len(points), time_s))
        traced, maps = self._trace(rays, {"instance", "depth"}, RenderStats(), sky=True)
        # one row of cells: a decoder that looks aside sees ground on both sides
        rgb = self._decode(traced, directions, camera.sensor_id, (1, len(points)))[0, :: self.scene.model.config.upsample]
        return level_of(rgb[(maps["instance"] == 0) & (maps["depth"] < 2 * PROBE_M)])

    def _shaded(self, image: NDArray[np.float32], rays: Rays, maps: Maps, time_s: float) -> NDArray[np.float32]:
        """The image of rays (h, w) with contact shadows where they show the ground."""
        up = self.scene.model.config.upsample
        depth = maps["depth"].reshape(rays.time_s.shape).astype(np.float64)
        points = rays.origins + rays.directions * np.where(np.isfinite(depth), depth, 1e6)[..., None]
        ground = (maps["instance"].reshape(rays.time_s.shape) == 0) & np.isfinite(depth)
        points, ground = (np.repeat(np.repeat(x, up, 0), up, 1)[: image.shape[0], : image.shape[1]] for x in (points, ground))
        return shaded(image, points, ground, self.shaders, time_s)

    @torch.no_grad()
    def lidar(self, lidar_id: str, frame: int) -> LidarFrame:
        """One sweep."""
        begun = time.perf_counter()
        lidar: Lidar = _pick(self.drive.lidars, lidar_id, "LiDAR")
        if not lidar.model.beams:
            raise SceneError(f"LiDAR {lidar_id!r} has no beam table: the log has plain points of it")
        rays = lidar_rays(lidar, frame)
        shape = rays.time_s.shape
        stats = RenderStats()
        flat = rays.flat()
        measured = self.rays_lidar(flat.origins, flat.directions, flat.time_s, stats=stats)
        depth, intensity, probability = (x.reshape(shape) for x in measured[:3])
        instance = measured[3].reshape(shape)
        returned = (
            (probability >= self._thresholds(lidar_id, frame, shape))
            & (depth >= lidar.model.min_range_m)
            & (depth <= lidar.model.max_range_m)
        )
        if lidar.blocked is not None:
            returned &= ~lidar.blocked
        stats.seconds = {"trace": time.perf_counter() - begun}
        return LidarFrame(
            lidar.model, lidar.world_from_lidar.at(lidar.time_s[frame]), rays.origins, rays.directions, rays.time_s,
            depth, intensity, probability, returned, instance, self.who.uids, stats,
        )  # fmt: skip

    def _thresholds(self, lidar_id: str, frame: int, shape: tuple[int, ...]) -> FloatArray | float:
        """What a beam's probability must reach: half, or a number in (0, 1] that depends on the seed and the sweep alone."""
        if self.draw is None:
            return 0.5
        return 1.0 - np.random.default_rng([self.draw, frame, *lidar_id.encode()]).random(shape)

    @torch.no_grad()
    def rays_lidar(
        self, origins: FloatArray, directions: FloatArray, time_s: FloatArray, stats: RenderStats | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
        """Depth in metres, intensity in 0..1, probability of a return, instance (N,) of any LiDAR rays (N, 3), world frame."""
        stats = RenderStats() if stats is None else stats
        rays = Rays(origins, directions, time_s)
        met = self.who.extras.met_by_rays(rays, NEAR_M)
        traced, maps = self._trace(rays, {"instance", "depth"}, stats, sky=False, met=met)
        directions_t = torch.as_tensor(directions, dtype=torch.float32, device=self.device)
        head = self.scene.model.lidar_head
        intensity, logit = head(traced.feature, directions_t, traced.depth_m, traced.opacity)
        for i, guest in enumerate(self.cast.guests.values()):
            share = traced.guest_opacity[i].clamp(0, 1)
            own = traced.guest_features[i] / share.clamp_min(1e-3)[:, None]
            i_guest, l_guest = guest.scene.lidar_head(own, directions_t, traced.depth_m, traced.opacity)
            intensity, logit = torch.lerp(intensity, i_guest, share), torch.lerp(logit, l_guest, share)
        # what meets nothing returns nothing
        probability = torch.sigmoid(logit) * (traced.opacity > 0.5)
        if met is not None and traced.mesh_opacity is not None:
            ray, share = torch.as_tensor(met.ray, device=self.device), traced.mesh_opacity
            bright = torch.zeros_like(intensity)
            bright[ray] = torch.as_tensor(met.intensity, dtype=bright.dtype, device=self.device)
            intensity, probability = torch.lerp(intensity, bright, share), torch.lerp(probability, torch.ones_like(share), share)
        depth = np.nan_to_num(maps["depth"], posinf=0.0)
        return depth, intensity.cpu().numpy(), probability.cpu().numpy(), maps["instance"].astype(np.int32)

    def _trace(self, rays: Rays, passes: set[str], stats: RenderStats, sky: bool, met: Met | None = None) -> tuple[Traced, Maps]:
        """All rays in chunks; features joined, and for each pass one array (N, ...)."""
        batch = to_batch(rays, self.device)
        among = self._visible(rays, stats)
        sampling = Sampling(fine=self.sampling.fine, sky=sky)
        pieces, maps = [], []
        for begin in range(0, len(batch), CHUNK_RAYS):
            part = RayBatch(*(x[begin : begin + CHUNK_RAYS] for x in (batch.origins, batch.directions, batch.time_s)))
            surfaces = None if met is None else met.between(begin, begin + CHUNK_RAYS)
            traced = trace(self.scene.model, self.cast, part, sampling, among, surfaces)
            self._count(part, traced, stats)
            maps.append(ray_passes(self.scene, self.cast, part, traced, passes))
            traced.strands = []
            pieces.append(traced)
        return _join(pieces), {name: np.concatenate([m[name] for m in maps]) for name in maps[0]}

    def _visible(self, rays: Rays, stats: RenderStats) -> Tensor | None:
        """Own actors that rays can meet: present at some ray's time, and not behind the cone that holds the rays."""
        keep = self.bounds.in_reach(rays)
        stats.actors_skipped += len(self.who.own.actors) - len(keep)
        return torch.tensor(keep, dtype=torch.long, device=self.device)

    def _count(self, part: RayBatch, traced: Traced, stats: RenderStats) -> None:
        frame = self.scene.model.frame
        near, far = frame.span(frame.points(part.origins), frame.vectors(part.directions), 0.5)
        uniform = int(((far - near) / UNIFORM_STEP_M).ceil().sum())
        config = self.scene.model.config.samples
        # what places a sample costs a distance query too
        spent = traced.samples + sum(
            len(s.ray) * (config.static_proposals if s.bounds is None else config.actor_proposals)
            for s in traced.strands
            if s.normals is None
        )
        stats.rays += len(part)
        stats.samples_spent += spent
        stats.samples_saved += max(0, uniform - spent)

    def _decode(self, traced: Traced, along: FloatArray, camera_id: str, shape: tuple[int, ...]) -> NDArray[np.float32]:
        directions = torch.as_tensor(along.reshape(-1, 3), dtype=torch.float32, device=self.device)

        def image(network: SceneModel, feature: Tensor) -> Tensor:
            code = network.camera_ids.get(camera_id, -1)
            number = torch.full((len(feature),), code, dtype=torch.long, device=self.device)
            features = network.ray_head(feature, directions, number)
            decoded: Tensor = network.camera_decoder(features.view(1, *shape, -1).permute(0, 3, 1, 2))
            return decoded

        own = traced.feature if traced.without_guests is None else traced.without_guests
        rgb = image(self.scene.model, own)
        for i, troupe in enumerate(self.cast.guests.values()):
            # each scene's features are its own decoder's: the pictures are laid over each other, not the features
            share = traced.guest_opacity[i].clamp(0, 1)
            feature = _spread_over_edges(traced.guest_features[i], share, shape)
            other = image(troupe.scene, feature)
            alpha = F.interpolate(share.view(1, 1, *shape), size=rgb.shape[-2:], mode="bilinear", align_corners=False)
            if other.shape != rgb.shape:
                other = F.interpolate(other, size=rgb.shape[-2:], mode="bilinear", align_corners=False)
            rgb = torch.lerp(rgb, other, alpha)
        return rgb[0].permute(1, 2, 0).cpu().numpy().astype(np.float32)


def observe(scene: Scene, cameras: Sequence[str], frames: Sequence[int], points: FloatArray) -> torch.Tensor:
    """Mark the voxels that training images and LiDAR returns (N, 3) show, for the mask of what nothing recorded supports.

    Those next to them are marked too: a surface on the border of two voxels is in one at one time, in the other at another.
    Returns which voxels (V,) bool, flat, the images look through on the way: nobody saw anything there, and it was in view.
    """
    model = scene.model
    seen, through = model.observed.view(-1), torch.zeros_like(model.observed, dtype=torch.bool).view(-1)
    into = invert_pose(model.volume.world_from_volume)
    seen[model.occupancy.cells(torch.as_tensor(transform_points(into, points)).float().to(seen.device))] = 1
    renderer = Renderer(scene, scene.header.drive, quality="fast")
    outlines = outlines_from_json(scene.header.training.get("own_vehicle"))
    for camera in cameras:
        for frame in frames:
            if frame not in renderer.drive.cameras[camera].time_s:
                continue
            shown = renderer.drive.cameras[camera]
            u, v = pixel_grid(shown.model, max(1, shown.model.width // 96))
            if camera in outlines:
                size = shown.model.width, shown.model.height
                scene_shown = shows_scene(*outlines[camera], u, v, size)
                u, v = u[scene_shown], v[scene_shown]
            rays = camera_rays(shown, frame, u, v).flat()
            with torch.no_grad():
                depth = torch.as_tensor(renderer._trace(rays, {"depth"}, RenderStats(), sky=False)[1]["depth"]).to(seen.device)
                batch = to_batch(rays, renderer.device)
                x = model.frame.points(batch.origins + batch.directions * depth[:, None])
                seen[model.occupancy.cells(x[model.frame.inside(x)])] = 1
                for cells in _ways(model, batch, depth - model.config.voxel_m):
                    through[cells] = True
    grown = F.max_pool3d(model.observed[None, None].float(), 3, stride=1, padding=1)[0, 0]
    model.observed.copy_(grown)
    return through


def _ways(model: SceneModel, rays: RayBatch, depth_m: torch.Tensor) -> Iterator[torch.Tensor]:
    """Flat voxel numbers that rays come through before depths (N,), a part of the rays at a time."""
    o, d = model.frame.points(rays.origins), model.frame.vectors(rays.directions)
    reach = torch.minimum(depth_m, model.frame.span(o, d, NEAR_M)[1])
    step = model.config.voxel_m / 2
    for part in torch.arange(len(o), device=o.device).split(1024):
        t = (torch.arange(int(reach[part].max().clamp_min(0) / step) + 1, device=o.device) + 0.5) * step
        x = o[part, None] + t[:, None] * d[part, None]
        yield model.occupancy.cells(x[(t < reach[part, None]) & model.frame.inside(x)])


def to_batch(rays: Rays, device: torch.device) -> RayBatch:
    """Rays as tensors on a device."""
    return RayBatch(
        torch.as_tensor(rays.origins, dtype=torch.float32).to(device).contiguous(),
        torch.as_tensor(rays.directions, dtype=torch.float32).to(device).contiguous(),
        tensor_to(torch.as_tensor(rays.time_s, dtype=torch.float64), device).contiguous(),
    )


Sensor = TypeVar("Sensor")


def _pick(sensors: dict[str, Sensor], sensor_id: str, kind: str) -> Sensor:
    if sensor_id not in sensors:
        raise SceneError(f"no {kind} {sensor_id!r} in the drive: there are {', '.join(sensors) or 'none'}")
    return sensors[sensor_id]


def _join(pieces: list[Traced]) -> Traced:
    guests = range(len(pieces[0].guest_features))
    return Traced(
        feature=torch.cat([p.feature for p in pieces]),
        depth_m=torch.cat([p.depth_m for p in pieces]),
        opacity=torch.cat([p.opacity for p in pieces]),
        behind=torch.cat([p.behind for p in pieces]),
        near_depth_m=torch.cat([p.near_depth_m for p in pieces]),
        near_opacity=torch.cat([p.near_opacity for p in pieces]),
        strands=[],
        samples=sum(p.samples for p in pieces),
        guest_features=[torch.cat([p.guest_features[i] for p in pieces]) for i in guests],
        guest_opacity=[torch.cat([p.guest_opacity[i] for p in pieces]) for i in guests],
        without_guests=_joined([p.without_guests for p in pieces]),
        mesh_opacity=_joined([p.mesh_opacity for p in pieces]),
    )


def _joined(parts: list[Tensor | None]) -> Tensor | None:
    there = [part for part in parts if part is not None]
    return torch.cat(there) if there else None


def _spread_over_edges(feature: Tensor, share: Tensor, shape: tuple[int, ...]) -> Tensor:
    """A guest's features (N, F), divided by its share of the ray and carried past its edges, where the decoder looks too."""
    f = feature.view(1, *shape, -1).permute(0, 3, 1, 2)
    a = share.view(1, 1, *shape)
    for _ in range(EDGE_CELLS):
        blurred_f, blurred_a = F.avg_pool2d(f, 3, 1, 1), F.avg_pool2d(a, 3, 1, 1)
        empty = a < 1e-3
        f, a = torch.where(empty, blurred_f, f), torch.where(empty, blurred_a, a)
    return (f / a.clamp_min(1e-3)).permute(0, 2, 3, 1).reshape(-1, f.shape[1])
