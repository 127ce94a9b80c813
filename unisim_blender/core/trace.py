"""Rays through the scene: samples placed, fields asked, everything along one ray put in depth order, weights, features.

The one path that training and rendering share. A *strand* is one ray inside one medium (the static field, one actor's box, one
copied box of space); it has K samples and K intervals, see `composite.logistic_intervals`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .cast import Cast, Troupe
from .composite import logistic_intervals, unisim_intervals, weights_from_tau
from .fields.ground import CLEARANCE_M
from .fields.scene import SceneModel
from .fields.tracklets import Hits
from .march import Segment, propose, refine_quantiles, stratified

NEAR_M = 0.5
OPAQUE = 1e-3
"""Transmittance under which nothing behind is computed."""
EMPTY_M = 10.0
"""The distance that stands for empty space."""


@dataclass(frozen=True)
class RayBatch:
    """Rays as tensors: origins, directions (N, 3) world frame float32, time_s (N,) float64."""

    origins: Tensor
    directions: Tensor
    time_s: Tensor

    def __len__(self) -> int:
        return len(self.origins)


@dataclass(frozen=True)
class Sampling:
    """``jitter`` draws samples at random in their strata; ``fine`` multiplies their number; ``far`` asks for the far field,
    ``sky`` for what lies behind that and for the light it gives: a camera sees them, a LiDAR does not."""

    jitter: bool = False
    fine: float = 1.0
    far: bool = True
    sky: bool = True
    mirror: Tensor | None = None
    """(looks,) chance that a look is mirrored, in training."""
    generator: torch.Generator | None = None


@dataclass
class Strands:
    """Strands of one medium: ray (P,), samples t (P, K), signed distances s, features (P, K, F), tau and share (P, K).

    ``points`` (P, K, 3) in the medium's own coordinates (volume, metres; or an actor's unit cube); ``medium`` (P,) is -1 for the
    static field, else the actor's number in the cast.
    """

    ray: Tensor
    t: Tensor
    s: Tensor
    features: Tensor
    tau: Tensor
    share: Tensor
    points: Tensor
    medium: Tensor
    guest: int = -1
    """Which guest troupe's features these are; -1 for the scene's own."""
    bounds: tuple[Tensor, Tensor] | None = None
    """Where the strand enters and leaves its box (P,), (P,)."""
    world_from_box: Tensor | None = None
    """Rotation of the strand's box (P, 3, 3), for an actor; for a copied box the one from the source to the copy."""
    size_m: Tensor | None = None
    """Edges of the strand's box (P, 3), for an actor."""
    beta: float = 0.0
    """The density's sharpness in this medium, 1 / metres."""
    front: Tensor | None = None
    """Transmittance in front of the intervals (P, K), once composited."""
    weight: Tensor | None = None
    """Weights of the samples (P, K), once composited."""
    interval_weight: Tensor | None = None
    """Weights of the intervals (P, K), once composited."""

    def stops(self) -> Tensor:
        """Where a ray that stops in an interval is expected to (P, K), metres along the ray; without gradients."""
        with torch.no_grad():
            near = torch.cat([self.t[:, :1], self.t[:, :-1]], -1)
            alpha = -torch.expm1(-self.tau)
            inside = torch.where(alpha > 1e-6, self.share / alpha.clamp_min(1e-6), torch.full_like(alpha, 0.5))
            return near + inside * (self.t - near)


@dataclass
class Traced:
    """What the rays met. feature (N, F) composited, the far field and the sky included where they were asked for; depth_m (N,)
    mean distance of what stopped the ray, 0 where nothing did; opacity (N,) and behind (N,), 1 - opacity, without the sky."""

    feature: Tensor
    depth_m: Tensor
    opacity: Tensor
    behind: Tensor
    strands: list[Strands]
    samples: int
    guest_features: list[Tensor]
    guest_opacity: list[Tensor]
    near_depth_m: Tensor
    """Mean distance (N,) of what stopped the ray inside the volume, the far field left out."""
    near_opacity: Tensor
    far: tuple[Tensor, Tensor, Tensor, Tensor] | None = None
    """What the far field gave: ray (R,), t, tau, and the transmittance in front (R, K)."""
    without_guests: Tensor | None = None
    """``feature`` as if no guest were there; None where none is."""


def trace(scene: SceneModel, cast: Cast, rays: RayBatch, sampling: Sampling, among: Tensor | None = None) -> Traced:
    """Features, depths and opacities of rays. ``among`` names the own actors that can be met; the others are skipped."""
    actors = _actor_strands(cast.own, rays, sampling, among, first=0, guest=-1)
    first = len(cast.own.uids)
    for i, troupe in enumerate(cast.guests.values()):
        actors += _actor_strands(troupe, rays, sampling, None, first=first, guest=i)
        first += len(troupe.uids)
    static = _static_strands(scene, cast, rays, sampling, actors)
    strands = [s for s in (static, *actors, *_copy_strands(scene, cast, rays, sampling)) if len(s.ray)]
    widths = [troupe.scene.config.features for troupe in cast.guests.values()]
    if cast.guests:
        # what the scene's own decoder is to see: everything but the guests
        own = _composite(scene, len(rays), [s for s in strands if s.guest < 0], [], rays.origins)
        if sampling.far:
            _add_far(scene, rays, sampling, own)
    traced = _composite(scene, len(rays), strands, widths, rays.origins)
    if sampling.far:
        _add_far(scene, rays, sampling, traced)
    if cast.guests:
        traced.without_guests = own.feature
    traced.samples += sum(s.t.numel() for s in strands)
    return traced


def _intervals(scene: SceneModel, s: Tensor, t: Tensor, actor: bool) -> tuple[Tensor, Tensor]:
    beta = scene.beta()
    if scene.config.density == "unisim":
        return unisim_intervals(s, t, beta, scene.config.unisim_step_m if not actor else scene.config.unisim_step_m / 4)
    return logistic_intervals(s, beta)


def _count(n: int, sampling: Sampling) -> int:
    return max(2, round(n * sampling.fine))


def _static_strands(scene: SceneModel, cast: Cast, rays: RayBatch, sampling: Sampling, actors: list[Strands]) -> Strands:
    o, d = scene.frame.points(rays.origins), scene.frame.vectors(rays.directions)
    t_near, t_far = scene.frame.span(o, d, NEAR_M)
    n, samples = len(rays), scene.config.samples
    u = stratified(n, _count(samples.static_proposals, sampling), sampling.jitter, o, sampling.generator)
    with torch.no_grad():
        t, mass = propose(scene.occupancy.voxels, Segment(o, d, t_near, t_far), u)
        ray = torch.nonzero((mass > 0) & (t_far > t_near))[:, 0]
        # free space: rays that meet no occupied voxel take no sample
        o, d, u, t = o[ray], d[ray], u[ray], t[ray]
        segment = Segment(o, d, t_near[ray], t_far[ray])
        points = o[:, None] + t[..., None] * d[:, None]
        s = scene.static.distance(points.reshape(-1, 3)).view(t.shape)
        s = _cleared(scene, cast, rays, actors, ray, t, points, s)
        jitter = stratified(len(ray), _count(samples.static, sampling), sampling.jitter, o, sampling.generator)
        quantiles = refine_quantiles(u, t, s, float(scene.beta().detach()), jitter.shape[1], jitter)
        t, _ = propose(scene.occupancy.voxels, segment, quantiles)
    points = o[:, None] + t[..., None] * d[:, None]
    s, feature = scene.static(points.reshape(-1, 3))
    feature = scene.directed(feature, rays.directions[ray].repeat_interleave(t.shape[1], 0))
    s = _cleared(scene, cast, rays, actors, ray, t, points, s.view(t.shape))
    tau, share = _intervals(scene, s, t, actor=False)
    medium = torch.full_like(ray, -1)
    feature = feature.view(*t.shape, scene.config.features)
    return Strands(ray, t, s, feature, tau, share, points, medium, beta=float(scene.beta().detach()))


def _actor_strands(
    troupe: Troupe, rays: RayBatch, sampling: Sampling, among: Tensor | None, first: int, guest: int
) -> list[Strands]:
    if not troupe.uids or (among is not None and len(among) == 0):
        return []
    hits = troupe.tracklets.hits(rays.origins, rays.directions, rays.time_s, NEAR_M, among)
    if len(hits.ray) == 0:
        return []
    scene, samples = troupe.scene, troupe.scene.config.samples
    size, row = troupe.tracklets.sizes_m[hits.actor], troupe.rows[hits.actor]
    flip = None
    if sampling.mirror is not None:
        chance = torch.rand(len(row), generator=sampling.generator, device=row.device)
        flip = torch.where(chance < sampling.mirror[row], -1.0, 1.0)

    def unit(t: Tensor) -> Tensor:
        x = (hits.origins[:, None] + t[..., None] * hits.directions[:, None]) / size[:, None]
        if flip is not None:
            x = torch.stack([x[..., 0], x[..., 1] * flip[:, None], x[..., 2]], -1)
        return x + 0.5

    span = (hits.t_far - hits.t_near)[:, None]
    with torch.no_grad():
        count = _count(samples.actor_proposals, sampling)
        u = stratified(len(row), count, sampling.jitter, span, sampling.generator)
        t = hits.t_near[:, None] + u * span
        s = scene.actors.distance(troupe.tables, unit(t).reshape(-1, 3), row.repeat_interleave(count)).view(t.shape)
        jitter = stratified(len(row), _count(samples.actor, sampling), sampling.jitter, span, sampling.generator)
        t = hits.t_near[:, None] + refine_quantiles(u, t, s, float(scene.beta().detach()), jitter.shape[1], jitter) * span
    points = unit(t)
    s, feature = scene.actors(troupe.tables, points.reshape(-1, 3), row.repeat_interleave(t.shape[1]))
    if sampling.sky and scene.light is not None:
        middle = rays.origins[hits.ray] + t[:, t.shape[1] // 2, None] * rays.directions[hits.ray]
        place = scene.frame.points(middle) if guest < 0 else scene.light.home[row]
        feature = scene.lit(feature.view(*t.shape, -1), place).flatten(0, 1)
    directions = rays.directions[hits.ray]
    if flip is not None:
        directions = _mirrored(directions, hits.world_from_box[:, :, 1], flip)
    feature = scene.directed(feature, directions.repeat_interleave(t.shape[1], 0))
    s = s.view(t.shape)
    tau, share = _intervals(scene, s, t, actor=True)
    return [
        Strands(
            hits.ray,
            t,
            s,
            feature.view(*t.shape, scene.config.features),
            tau,
            share,
            points,
            hits.actor + first,
            guest,
            (hits.t_near, hits.t_far),
            hits.world_from_box,
            size,
            float(scene.beta().detach()),
        )
    ]


def _mirrored(directions: Tensor, across: Tensor, flip: Tensor) -> Tensor:
    """Directions (P, 3) as a box sees them whose axis ``across`` (P, 3) is flipped where ``flip`` (P,) is -1."""
    return directions + ((flip - 1) * (directions * across).sum(-1))[:, None] * across


def _copy_strands(scene: SceneModel, cast: Cast, rays: RayBatch, sampling: Sampling) -> list[Strands]:
    """What stands above the ground in a source box, seen where its copy stands."""
    if cast.copies is None or cast.copy_source is None:
        return []
    hits: Hits = cast.copies.hits(rays.origins, rays.directions, rays.time_s, NEAR_M)
    if len(hits.ray) == 0:
        return []
    samples = scene.config.samples
    pose = cast.copy_source[hits.actor]
    o = scene.frame.points(torch.einsum("pij,pj->pi", pose[:, :3, :3], hits.origins) + pose[:, :3, 3])
    d = scene.frame.vectors(torch.einsum("pij,pj->pi", pose[:, :3, :3], hits.directions))
    span = (hits.t_far - hits.t_near)[:, None]
    u = stratified(len(o), _count(2 * samples.static, sampling), sampling.jitter, o, sampling.generator)
    t = hits.t_near[:, None] + u * span
    points = o[:, None] + t[..., None] * d[:, None]
    s, feature = scene.static(points.reshape(-1, 3))
    # the source's ground stays where it is
    s = torch.where(scene.ground.above(points.reshape(-1, 3)), s, EMPTY_M).view(t.shape)
    feature = scene.directed(feature, rays.directions[hits.ray].repeat_interleave(t.shape[1], 0))
    tau, share = _intervals(scene, s, t, actor=False)
    medium = torch.full_like(hits.ray, -2)
    feature = feature.view(*t.shape, scene.config.features)
    strands = Strands(hits.ray, t, s, feature, tau, share, points, medium, beta=float(scene.beta().detach()))
    strands.world_from_box = hits.world_from_box @ pose[:, :3, :3].mT
    return [strands]


def _cleared(
    scene: SceneModel, cast: Cast, rays: RayBatch, actors: list[Strands], ray: Tensor, t: Tensor, points: Tensor, s: Tensor
) -> Tensor:
    """The static field's distances s (P, K) at samples t (P, K), points (P, K, 3), of rays (P,), as a ray may meet them.

    Inside a present actor's box, and in a removed box, nothing stands above the ground: the ground is then all that is near.
    """
    inside = _in_boxes(cast, rays, actors, ray, t)
    rows, columns = torch.nonzero(inside, as_tuple=True)
    if len(rows) == 0:
        return s
    x = points[rows, columns]
    height = x[:, 2] - scene.ground.height(x)
    own = s[rows, columns]
    return s.index_put((rows, columns), torch.where(height > CLEARANCE_M, torch.maximum(own, height), own))


@torch.no_grad()
def _in_boxes(cast: Cast, rays: RayBatch, actors: list[Strands], ray: Tensor, t: Tensor) -> Tensor:
    """Which samples t (P, K) of rays (P,) lie in the box of an actor that the ray meets, or in a removed one: (P, K)."""
    covers = torch.zeros_like(t)
    row_of_ray = torch.full((len(rays),), -1, dtype=torch.long, device=t.device)
    row_of_ray[ray] = torch.arange(len(ray), device=t.device)
    for strand in actors:
        assert strand.bounds is not None
        row = row_of_ray[strand.ray]
        known = row >= 0
        row, near, far = row[known], strand.bounds[0][known], strand.bounds[1][known]
        covered = (t[row] >= near[:, None]) & (t[row] <= far[:, None])
        covers.index_put_((row,), covered.to(covers.dtype), accumulate=True)
    inside = covers > 0
    if cast.removals is not None:
        for pose, size in zip(*cast.removals, strict=True):
            x = rays.origins[ray][:, None] + t[..., None] * rays.directions[ray][:, None]
            inside |= ((x @ pose[:3, :3].mT + pose[:3, 3]).abs() <= size / 2).all(-1)
    return inside


def _composite(scene: SceneModel, rays: int, strands: list[Strands], guests: list[int], like: Tensor) -> Traced:
    """Everything on each ray in order of depth; ``guests`` are the lengths of the guest scenes' features."""
    width = scene.config.features
    feature, depth, total, log_behind = like.new_zeros(rays, width), *(like.new_zeros(rays) for _ in range(3))
    guest_features = [like.new_zeros(rays, own) for own in guests]
    guest_opacity = [like.new_zeros(rays) for _ in guests]
    for strand, front in zip(strands, _transmittances(rays, strands), strict=True):
        strand.front = front
        strand.interval_weight = front * -torch.expm1(-strand.tau)
        far_part = front * strand.share
        near_part = strand.interval_weight - far_part
        # an interval's weight goes to the samples at its two ends; interval 0 has only its own
        weight = far_part + torch.cat([near_part[:, 1:], torch.zeros_like(near_part[:, :1])], -1)
        weight = torch.cat([weight[:, :1] + strand.interval_weight[:, :1], weight[:, 1:]], -1)
        strand.weight = weight
        part, share = (weight[..., None] * strand.features).sum(1), weight.sum(1)
        if strand.guest < 0:
            feature = feature.index_add(0, strand.ray, part)
        else:
            guest_features[strand.guest] = guest_features[strand.guest].index_add(0, strand.ray, part)
            guest_opacity[strand.guest] = guest_opacity[strand.guest].index_add(0, strand.ray, share)
        depth = depth.index_add(0, strand.ray, (weight * strand.t).sum(1))
        total = total.index_add(0, strand.ray, share)
        log_behind = log_behind.index_add(0, strand.ray, -strand.tau.sum(1))
    depth, opacity = depth / total.clamp_min(1e-6), -torch.expm1(log_behind)
    return Traced(
        feature=feature, depth_m=depth, opacity=opacity, behind=torch.exp(log_behind), strands=strands, samples=0,
        guest_features=guest_features, guest_opacity=guest_opacity, near_depth_m=depth, near_opacity=opacity,
    )  # fmt: skip


def _transmittances(rays: int, strands: list[Strands]) -> list[Tensor]:
    """The transmittance in front of every interval (P, K) of each group of strands, all media of a ray in one order of depth."""
    if not strands:
        return []
    out = [weights_from_tau(strand.tau)[0] for strand in strands]
    all_rays = torch.cat([s.ray for s in strands])
    crossed = torch.bincount(all_rays, minlength=rays) > 1
    if not bool(crossed.any()):
        return out
    device = all_rays.device
    mixed_ray = torch.cumsum(crossed, 0) - 1
    # every ray with several strands gets a row, every strand of it a slot in the row
    order = torch.argsort(all_rays, stable=True)
    _, counts = torch.unique_consecutive(all_rays[order], return_counts=True)
    starts = torch.cumsum(counts, 0) - counts
    slot = torch.empty_like(all_rays)
    slot[order] = torch.arange(len(all_rays), device=device) - starts.repeat_interleave(counts)
    slots, longest = int(counts.max()), max(s.t.shape[1] for s in strands)
    rows = int(crossed.sum())
    tau = strands[0].t.new_zeros(rows * slots, longest)
    place = strands[0].t.new_full((rows * slots, longest), float("inf"))
    at, begin = [], 0
    for strand in strands:
        mine = torch.nonzero(crossed[strand.ray])[:, 0]
        cell = mixed_ray[strand.ray[mine]] * slots + slot[begin : begin + len(strand.ray)][mine]
        begin += len(strand.ray)
        at.append((mine, cell))
        pad = (0, longest - strand.t.shape[1])
        tau = tau.index_put((cell,), torch.nn.functional.pad(strand.tau[mine], pad))
        place = place.index_put((cell,), torch.nn.functional.pad(strand.stops()[mine], pad, value=float("inf")))
    tau, place = tau.view(rows, -1), place.view(rows, -1)
    by_depth = torch.argsort(place, dim=1, stable=True)
    front, _ = weights_from_tau(tau.gather(1, by_depth))
    front = torch.zeros_like(front).scatter(1, by_depth, front).view(rows * slots, longest)
    return [own.index_put((mine,), front[cell][:, : own.shape[1]]) for own, (mine, cell) in zip(out, at, strict=True)]


def _add_far(scene: SceneModel, rays: RayBatch, sampling: Sampling, traced: Traced) -> None:
    """The far field behind the volume, where anything of it can be seen: samples even in disparity, then the sky."""
    ray = torch.nonzero(traced.behind.detach() > OPAQUE)[:, 0]
    if len(ray) == 0:
        return
    o, d = scene.frame.points(rays.origins[ray]), scene.frame.vectors(rays.directions[ray])
    _, t_far = scene.frame.span(o, d, NEAR_M)
    count = scene.config.samples.far
    u = stratified(len(ray), count, sampling.jitter, o, sampling.generator)
    t0 = t_far.clamp_min(NEAR_M)[:, None]
    t = 1 / ((1 - u) / t0 + u / scene.config.far_m)
    x = o[:, None] + d[:, None] * t[..., None]
    raw, feature = scene.far(x.reshape(-1, 3))
    tau = torch.nn.functional.softplus(raw.view(u.shape))
    front, behind = weights_from_tau(tau)
    weight = front * -torch.expm1(-tau)
    directions = rays.directions[ray]
    feature = scene.directed(feature, directions.repeat_interleave(count, 0)).view(*u.shape, -1)
    far = (weight[..., None] * feature).sum(1)
    if sampling.sky:
        far = far + behind[:, None] * scene.directed(scene.far.sky(d), directions)
    reach = traced.behind[ray]
    stopped = traced.depth_m * traced.opacity
    stopped = stopped.index_add(0, ray, reach * (weight * t).sum(1))
    traced.far = (ray, t, tau, reach[:, None] * front)
    traced.feature = traced.feature.index_add(0, ray, reach[:, None] * far)
    traced.behind = traced.behind.index_put((ray,), reach * behind)
    traced.opacity = 1 - traced.behind
    traced.depth_m = stopped / traced.opacity.clamp_min(1e-6)
    traced.samples += u.numel() + len(ray)
