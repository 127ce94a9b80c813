"""Losses on the signed distances in training, in addition to those of rendered rays: LiDAR returns, slopes, the
ground."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ...model.fields import CORNERS, outward_gradient
from ...model.occupancy import OccupancyTrainer
from ...model.scene import SceneModel
from ...ops.composite import SegmentWeights
from ...ops.constants import GROUND_CELL_M
from ...ops.padding import compact, drawn, masked_mean
from ...ops.ray_segments import ActorSegments, FieldSegments, rows_of
from ...ops.segment_trace import SegmentTrace
from ..batches.sweeps import LidarBatch
from .terms import eikonal, normal_smoothness, sdf_band_loss, wrong_side

_BAND_M = 0.3
"""Distance before a return over which the signed distance is between bounds that the way to it gives."""
_ACTOR_BAND_M = 0.15
"""The same inside of an actor's box."""
_WALL_M, _DEEP_M = 0.3, 0.1
"""Distance behind a return over which the static distance is below zero: by a fifth of the way from the return, and of
the last at most. Nearer than the last nothing is asked: among returns that scatter by centimetres it would pull the
surface to the sensor."""
_SOLID_M, _SOLID_SHARE = 0.4, 0.25
"""An actor's is as far behind a return in its box, and as far as this share of the box's shortest edge."""
_PASSED_M, _FREE_M = 4.0, 0.02
"""Distance before it over which the way is free, and the distance at least this."""
_SKIN_M, _CLEAR_M = 0.1, 0.15
"""So far behind the face of an actor's box where a beam enters it, it is this: there are neither skins nor haze."""
_SHEET_M = 0.2
"""Where a ray stops before it, this far behind the stop at most is looked."""
_SENSOR_M = 1.0
"""Nothing is said about the sensor's own vehicle."""
_FLAT_M = 0.4
"""Surfaces are compared with themselves up to this far away."""
_STEP_M = 0.06
"""Over this distance the signed distance's gradient is taken: about the finest cell."""


class ShapeLosses:
    """The loss's terms about a model's distances; ``known_ground`` (C, 2) are the cells whose ground
    height can be trusted. ``padded`` says that no shape may depend on values."""

    padded = False

    def __init__(self, model: SceneModel, occupancy: OccupancyTrainer, known_ground: Tensor) -> None:
        self.model, self.occupancy, self.known_ground = model, occupancy, known_ground

    def sdf_band(
        self, tables: Tensor, swept: SegmentTrace, lidar: LidarBatch, generator: torch.Generator | None
    ) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """Return the loss of signed distances at and before LiDAR returns, and points (N, 3) of which those marked (N,)
        are of the static field and near such returns.

        ``tables`` are the actors' grids; ``swept`` is what the rays of ``lidar`` hit.
        """
        model = self.model
        o, d = model.frame.points(lidar.rays.origins), model.frame.vectors(lidar.rays.directions)
        hits = o.new_zeros(len(o))
        end = o + d * lidar.depth_m[:, None]
        above = model.ground.above(end)
        band = o.new_zeros(())
        for segments in swept.ray_segments:
            if not isinstance(segments, ActorSegments):
                continue
            depth = lidar.depth_m[segments.ray]
            hit = lidar.returned[segments.ray] & above[segments.ray] & segments.contain(depth)
            hits = hits.index_add(0, segments.ray, hit.to(hits.dtype))
            band = band + self._actor_passed(segments, lidar, tables, generator)
            if not self.padded:
                index = torch.nonzero(hit)[:, 0]
                segments, depth, hit = rows_of(segments, index), depth[index], hit[index]  # noqa: PLW2901
            if len(hit):
                band = band + self._actor_band(segments, hit, depth, tables, generator)
        # a ray that grazes the road is early as often as late
        stop_m = torch.where(above & (swept.volume_opacity > 0.5), swept.volume_depth_m.detach(), torch.inf)
        static = lidar.returned & model.frame.inside(end) & (hits == 0)
        static, o, d, end, above, depth_m, stop_m = compact(
            self.padded, static, o, d, end, above, lidar.depth_m, stop_m
        )  # fmt: skip
        offset = self._offsets(len(o), generator, _BAND_M)
        x = o + d * (depth_m - offset)[:, None]
        band = band + masked_mean(sdf_band_loss(model.static.signed_distance(x), offset), static)
        ground, returns = compact(self.padded, static & ~above, end)
        band = band + self._ground_band(returns, ground, generator)
        band = band + self._passed(o, d, depth_m, stop_m, static, generator)
        return band + self._wall_band(o, d, depth_m, static, generator), (x.detach(), static)

    def _actor_passed(
        self, segments: ActorSegments, lidar: LidarBatch, tables: Tensor, generator: torch.Generator | None
    ) -> Tensor:
        """Return the loss of actors' signed distances where beams that returned pass through boxes, up to the return: mean
        depth of what lies below what is free, half of it at the faces where they enter.

        Images of who is seen from one side alone fit a skin on the box's face as well as a body, and the body's losses do
        not reach it. Samples of rays seldom lie there, and a renderer's first one always does.
        """
        end = torch.minimum(lidar.depth_m[segments.ray] - _ACTOR_BAND_M, segments.t_far)
        passed = lidar.returned[segments.ray] & (segments.t_near < end)
        if not self.padded:
            index = torch.nonzero(passed)[:, 0]
            segments, end, passed = rows_of(segments, index), end[index], passed[index]
            if not len(index):
                return end.sum()
        even, skin = torch.rand(2, len(end), generator=generator, device=end.device)
        entering = skin < 0.5
        depth_m = segments.t_near + even * (end - segments.t_near)
        depth_m = torch.where(entering, segments.t_near + even * (end - segments.t_near).clamp_max(_SKIN_M), depth_m)
        s = self.model.actors.signed_distance(tables, segments.at(depth_m).clamp(0, 1), segments.actor)
        return masked_mean(F.relu(torch.where(entering, _CLEAR_M, _FREE_M) - s), passed)

    def _actor_band(
        self, segments: ActorSegments, hit: Tensor, depth_m: Tensor, tables: Tensor, generator: torch.Generator | None
    ) -> Tensor:
        """Return the loss of actors' signed distances around returns in their boxes, at depth_m (P,) of those ray
        segments (P,) bool that ``hit`` one.

        Behind what it returned an actor is solid. Of a mere shell most of a ray's samples know nothing, and images
        paint it onto what is far behind: a lorry that drives ahead keeps its bearing, as the street's end does.
        """
        actor = segments.actor
        offset = self._offsets(len(actor), generator, _ACTOR_BAND_M)
        s = self.model.actors.signed_distance(tables, segments.at(depth_m - offset).clamp(0, 1), actor)
        band = masked_mean(sdf_band_loss(s, offset), hit)
        reach = (_SOLID_SHARE * segments.size_m.amin(-1)).clamp_max(_SOLID_M)
        behind = _behind(reach, generator)
        x = segments.at(depth_m + behind)
        inside = ((x > 0) & (x < 1)).all(-1)
        s = self.model.actors.signed_distance(tables, x.clamp(0, 1), actor)
        return band + masked_mean(_hinge(s, behind) * inside, hit)

    def _wall_band(
        self, o: Tensor, d: Tensor, depth_m: Tensor, static: Tensor, generator: torch.Generator | None
    ) -> Tensor:
        """Return the loss of static signed distances behind those returns (N,) that are ``static``, on rays o, d (N, 3)
        at depth_m (N,): walls are solid as actors are."""
        behind = _behind(torch.full_like(depth_m, _WALL_M), generator)
        x = o + d * (depth_m + behind)[:, None]
        there = self.model.frame.inside(x) & self.model.ground.above(x)
        return masked_mean(_hinge(self.model.static.signed_distance(x), behind) * there, static)

    def slopes(
        self,
        tables: Tensor,
        swept: SegmentTrace,
        seen: SegmentTrace,
        near: tuple[Tensor, Tensor],
        generator: torch.Generator | None,
    ) -> dict[str, Tensor]:
        """``eikonal``: gradients of length 1; ``normal_smoothness``: normals that turn little.

        ``swept`` and ``seen`` are what LiDAR's and the cameras' rays hit, of which only places count; ``near`` (N, 3)
        are points, and (N,) which of them are near returns.
        """
        pick, some = drawn(near[1], 512, generator)
        parts = [(eikonal(self._static_gradient(near[0][pick])), some)]
        for segments, weights in (*seen.weighted(), *swept.weighted()):
            assert isinstance(segments, FieldSegments)
            gradient, some = self._gradient(segments, weights, tables, generator)
            parts.append((eikonal(gradient), some))
        losses, there = torch.cat([loss for loss, _ in parts]), torch.cat([s.expand(len(loss)) for loss, s in parts])
        return {"eikonal": masked_mean(losses, there), "normal_smoothness": self._flatness(seen, generator)}

    def _passed(
        self,
        o: Tensor,
        d: Tensor,
        depth_m: Tensor,
        stop_m: Tensor,
        static: Tensor,
        generator: torch.Generator | None,
    ) -> Tensor:
        """In front of those returns (N,) that are ``static``, on rays o, d (N, 3) at depth_m (N,), the distance is above
        zero: mean depth of what lies below.

        What a ray sees of a solid wall that is not there has no slope: nothing gets through it that could be a little
        more. Where a ray stops too early, at stop_m (N,), that is where to look: a sheet is missed by nearly all that
        are drawn evenly.
        """
        even, behind = torch.rand(2, len(o), generator=generator, device=o.device)
        back = _BAND_M + (_PASSED_M - _BAND_M) * even
        early = depth_m - stop_m
        back = torch.where(early > _BAND_M, (early - _SHEET_M * behind).clamp_min(_BAND_M), back)
        t = depth_m - back
        below = F.relu(_FREE_M - self.model.static.signed_distance(o + d * t[:, None]))
        return masked_mean(below * (t > _SENSOR_M), static)

    def _flatness(self, seen: SegmentTrace, generator: torch.Generator | None) -> Tensor:
        """How much the normals of what images alone show turn within _FLAT_M along the surface: mean length
        of the difference.

        No LiDAR reaches high up and far away, and a drive straight on tells images little about depth.
        """
        if seen.static is None:
            return seen.feature.new_zeros(())
        segments, weights = seen.static
        pick, some = self._likely(weights, 512, generator)
        x = segments.points.detach().reshape(-1, 3)[pick]
        alone, x = compact(self.padded, some & ~self.occupancy.has_returns(x), x)
        beside = torch.randn(x.shape, generator=generator, device=x.device)
        with torch.no_grad():
            normal = F.normalize(self._static_gradient(x), dim=-1)
            beside = F.normalize(beside - (beside * normal).sum(-1, keepdim=True) * normal, dim=-1)
            beside = x + _FLAT_M * torch.rand(len(x), 1, generator=generator, device=x.device) * beside
        both = self._static_gradient(torch.cat([x, beside])).view(2, -1, 3)
        return masked_mean(normal_smoothness(both[0], both[1]), alone)

    def _static_gradient(self, x: Tensor) -> Tensor:
        return outward_gradient(self.model.static.signed_distance, x, _STEP_M)

    def _likely(self, weights: SegmentWeights, count: int, generator: torch.Generator | None) -> tuple[Tensor, Tensor]:
        """Numbers (count,) of random samples that carry weight; whether any does, () bool."""
        return drawn(weights.samples.detach().flatten() > 0.02, count, generator)

    def _gradient(
        self, segments: FieldSegments, weights: SegmentWeights, tables: Tensor, generator: torch.Generator | None
    ) -> tuple[Tensor, Tensor]:
        """Gradients (N, 3) of the distance at some samples that carry weight; whether any does, () bool."""
        pick, some = self._likely(weights, 384, generator)
        x = segments.points.detach().reshape(-1, 3)[pick]
        if not self.padded and not bool(some):
            return x[:0], some
        if not isinstance(segments, ActorSegments):
            return self._static_gradient(x), some
        row = pick // segments.t.shape[1]
        actor = segments.actor[row].repeat_interleave(CORNERS)
        gradient = outward_gradient(
            lambda y: self.model.actors.signed_distance(tables, y, actor), x, _STEP_M, segments.size_m[row]
        )
        return gradient, some

    def _ground_band(self, returns: Tensor, there: Tensor, generator: torch.Generator | None) -> Tensor:
        """Over and under returns (N, 3), of which those ``there`` (N,) are from the ground, the distance is the height;
        deeper, anywhere, it is well below zero where there is such a return.

        A ray that grazes the road would else pass a hair's breadth below it, where a distance of 0 stops nothing.
        """
        device = self.known_ground.device
        if len(returns) == 0 or len(self.known_ground) == 0:
            return returns.new_zeros(())
        height = torch.rand(len(returns), generator=generator, device=device) * 0.6 - 0.4
        height = torch.where(height > 0.1, torch.zeros_like(height), height)
        s = self.model.static.signed_distance(returns + F.pad(height[:, None], (2, 0)))
        band = masked_mean(sdf_band_loss(s, height) + F.relu(s - 0.8 * height) * (height < 0), there)
        cells = self.known_ground[torch.randint(len(self.known_ground), (256,), generator=generator, device=device)]
        place = (cells + torch.rand(256, 2, generator=generator, device=device)) * GROUND_CELL_M
        deep = 0.15 + 0.35 * torch.rand(256, generator=generator, device=device)
        x = self.model.ground.under(place) - F.pad(deep[:, None], (2, 0))
        return band + there.any() * F.relu(self.model.static.signed_distance(x) + 0.1).mean()

    def _offsets(self, count: int, generator: torch.Generator | None, reach_m: float) -> Tensor:
        """Offsets (N,) before (+) and, a third as far, behind (-) a return, as dense on both sides: returns scatter,
        and more of them on one side would move the surface to the other. A third of them is exactly at it."""
        device = self.known_ground.device
        offset = (torch.rand(count, generator=generator, device=device) * 1.3 - 0.3) * reach_m
        at = torch.rand(count, generator=generator, device=device) < 0.34
        return torch.where(at, torch.zeros_like(offset), offset)


def _behind(reach_m: Tensor, generator: torch.Generator | None) -> Tensor:
    """How far behind returns (N,) a solid that reaches so far is asked for: evenly, from where returns
    no longer scatter."""
    nearest = reach_m.clamp_max(_DEEP_M)
    return nearest + (reach_m - nearest) * torch.rand(len(reach_m), generator=generator, device=reach_m.device)


def _hinge(s: Tensor, behind_m: Tensor) -> Tensor:
    """What distances s (N,) lack so far behind returns, (N,), of a solid: (N,)."""
    return wrong_side(s, -behind_m.clamp_max(_DEEP_M))
