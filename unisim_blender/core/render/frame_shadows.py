"""Shadows on rendered images: of inserted actors on the ground, and of the sun, as edits have moved them."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb
from ..geometry import BoolArray, FloatArray
from ..meshes.exposure import PROBE_M
from ..sensors.frames import RenderStats
from ..sensors.rays import Rays
from .contact_shadow import dimmed, shaded
from .pending_image import Binding, PendingImage, colours_at, per_pixel
from .sun_shadow import FULL_SUN, GroundBeside, Relit, SunPatch, SunShadows, around
from .tracer import NEAR_M, Backend, Maps, Tracer


class FrameShadows:
    """The shadows in images that a backend traces."""

    def __init__(self, backend: Backend) -> None:
        self._blockers = {name: Binding(backend) for name in ("edited", "recorded", "bare")}

    def shaded(
        self,
        pending: PendingImage,
        image: NDArray[np.float32],
        points: FloatArray,
        ground: BoolArray,
        rays: Rays,
        maps: Maps,
    ) -> NDArray[np.float32]:
        """Return the image of rays (h, w) with contact shadows on the ground, and the sun's shadows that edits move. Pixels show
        ``points`` (H, W, 3), ``ground`` (H, W) where those are of no actor."""
        up, depth = pending.tracer.upsample, maps["depth"].reshape(rays.time_s.shape).astype(np.float64)
        shape = *rays.time_s.shape, 3
        rgb = image[up // 2 :: up, up // 2 :: up].reshape(-1, 3)
        image = shaded(image, points, ground, pending.shadowing, pending.time_s)
        if pending.shadows is None:
            return image
        light = self.sunlight(pending, rays.flat(), depth.reshape(-1), maps["instance"], rgb).reshape(shape)
        light = per_pixel(light, up, image.shape)
        return dimmed(image, light)

    def sunlight(
        self,
        pending: PendingImage,
        rays: Rays,
        depth: FloatArray,
        instance: NDArray[np.int32],
        rgb: NDArray[np.float32],
    ) -> FloatArray:
        """Return the factors (N, 3) by which edits change the light of what flat rays hit at depths (N,) and show as
        ``rgb`` (N, 3)."""
        shadows, out = pending.shadows, np.ones((len(depth), 3))
        assert shadows is not None
        solid = np.flatnonzero(np.isfinite(depth))
        rays = rays.part(solid)
        states = {"edited": shadows.edited, "recorded": shadows.recorded}

        def facing(some: NDArray[np.bool_]) -> FloatArray:
            part = rays.part(some)
            hits = pending.tracer.active.mesh_actors.seen_by(pending.camera).hit_by_rays(part, NEAR_M)
            normals = pending.tracer.trace(part, {"normal"}, False, hits, RenderStats()).maps["normal"]
            return np.asarray(normals, np.float64)

        points = rays.origins + rays.directions * depth[solid, None]
        tracers = {name: self._blockers[name].tracer(state, pending.tracer.quality) for name, state in states.items()}
        uids = pending.tracer.active.uids

        brightness = linear_from_srgb(rgb[solid]).mean(1).astype(np.float64)
        out[solid] = shadows.factors(
            points, rays.time_s, uids, instance[solid], facing, tracers, brightness,
            partial(self._beside, pending, shadows, tracers["recorded"]),
        )  # fmt: skip
        return out

    def relit(self, pending: PendingImage, rays: Rays, image: NDArray[np.float32], maps: Maps) -> NDArray[np.float32]:
        """Return the image (h, w, 3) of flat rays (h w,), with actors that edits have moved lit for where they stand."""
        shadows, tracer, light = pending.shadows, pending.tracer, np.ones((len(rays.time_s), 3))
        assert shadows is not None
        for each in shadows.relit:
            uid, uids = each.actors[0].uid, tracer.active.uids
            mine = maps["instance"] == (uids.index(uid) + 1 if uid in uids else -1)
            some = np.flatnonzero(mine & np.isfinite(maps["depth"]))
            if not len(some):
                continue
            if uid not in pending.patches:
                pending.patches[uid] = self._patches(pending, shadows, each)
            part = rays.part(some)
            points = part.origins + part.directions * maps["depth"][some, None].astype(np.float64)
            facing = tracer.trace(part, {"normal"}, False, None, RenderStats()).maps["normal"].astype(np.float64)
            at = Rays(points, facing, part.time_s)
            light[some] = shadows.gain(each, pending.patches[uid], at, tracer.heights)
        return dimmed(image, light.reshape(image.shape))

    def _patches(self, pending: PendingImage, shadows: SunShadows, relit: Relit) -> list[SunPatch]:
        """Return the shade on the grounds on which an actor's shadows fall."""
        recorded = self._blockers["recorded"].tracer(shadows.recorded, pending.tracer.quality)
        points = np.concatenate([ground[2] for ground in relit.grounds])
        known, brightness = self._probed(pending, shadows, points)
        known &= shadows.is_open(points)
        known[known] = shadows.in_recorded_sun(points[known], pending.time_s, recorded)
        return shadows.patches(relit, points, known, brightness, self._beside(pending, shadows, recorded))

    def _beside(self, pending: PendingImage, shadows: SunShadows, recorded: Tracer[Any]) -> GroundBeside:
        """Return the ground beside what has changed, in the camera's colours."""
        if pending.beside is not None:
            return pending.beside
        ring, wide = shadows.ring, around(pending.camera.world_from_camera.at(pending.time_s)[:3, 3])
        points = np.concatenate([ring, wide])
        known, brightness = self._probed(pending, shadows, points)
        of_wide = brightness[len(ring) :][known[len(ring) :]]
        full_sun = float(np.quantile(of_wide, FULL_SUN)) if len(of_wide) else 0.0
        known[len(ring) :] = False
        known[known] = shadows.in_recorded_sun(points[known], pending.time_s, recorded)
        pending.beside = GroundBeside(
            points[known], shadows.ring_owner[known[: len(ring)]], brightness[known], full_sun
        )
        return pending.beside

    def _probed(self, pending: PendingImage, shadows: SunShadows, points: FloatArray) -> tuple[BoolArray, FloatArray]:
        """Move points (N, 3) onto the bare ground, and return whether the scene has a surface there (N,) and its brightness
        (N,), linear, in the camera's colours."""
        bare = self._blockers["bare"].tracer(shadows.bare, pending.tracer.quality)
        points[:, 2] -= bare.heights(points)
        rgb, depth = colours_at(pending, points, self._blockers["bare"], bare)
        return depth < 2 * PROBE_M, linear_from_srgb(rgb).mean(1).astype(np.float64)
