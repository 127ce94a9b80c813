"""A case of sums: a hundred thousand intervals on one ray."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from unisim_blender.core.ops.composite import composite
from unisim_blender.core.ops.ray_segments import RaySegments
from unisim_blender.core.ops.transmittances import weights_from_tau
from unisim_blender.core.render.tracers.compiled.structs import address

from .measures import Bench, Measure, most
from .probe import probed


def ray_segments_of(tau: Tensor, t: Tensor, ray: Tensor) -> RaySegments:
    return RaySegments(ray, t, torch.ones_like(tau)[..., None], tau, tau * 0)


def accumulated(bench: Bench) -> Iterator[Measure]:
    """A hundred thousand intervals on one ray, even and uneven, by torch in float32 and by the kernels' headers."""
    n = 100_000
    rng = np.random.default_rng(0)
    t = np.linspace(0.5, 100, n).astype(np.float32)
    for name, tau in (
        ("even", np.full(n, 2e-5, np.float32)),
        ("uneven", rng.exponential(2e-5, n).astype(np.float32)),
        ("tiny", np.full(n, 1e-8, np.float32)),
        ("dense at last", np.r_[np.full(n - 1, 1e-6), 1e3].astype(np.float32)),
    ):
        before = np.concatenate([[0], tau.astype(np.float64).cumsum()])
        front, behind = weights_from_tau(torch.as_tensor(tau)[None])
        yield Measure(f"torch: transmittance, {name}", most(front[0], np.exp(-before[:-1])), 1e-6)
        yield Measure(f"torch: transmittance behind all, {name}", abs(float(behind) - float(np.exp(-before[-1]))), 1e-6)
        # a ray of one ray segment, and of two whose intervals take turns
        depths, rays = torch.as_tensor(t), torch.zeros(1, dtype=torch.long)
        whole = composite(1, [ray_segments_of(torch.as_tensor(tau)[None], depths[None], rays)], [1], depths)
        halves = [ray_segments_of(torch.as_tensor(tau[i::2].copy())[None], depths[i::2][None], rays) for i in range(2)]
        split = composite(1, halves, [1], depths)
        weight = np.exp(-before[:-1]) * -np.expm1(-tau.astype(np.float64))
        for what, traced in (("one ray segment", whole), ("two ray segments", split)):
            yield Measure(
                f"torch: weights' sum, {name}, {what}", abs(float(traced.feature) - float(weight.sum())), 2e-5
            )
            yield Measure(
                f"torch: opacity, {name}, {what}", abs(float(traced.opacity) + float(np.expm1(-before[-1]))), 2e-5
            )
        probe = probed()
        if probe is None:
            continue
        share, out = (-np.expm1(-tau) / 2).astype(np.float32), np.empty(n, np.float32)
        probe.probe_weights(
            1, n, address(t), address(tau), address(share), address(out), address(weighed := np.empty(n, np.float32))
        )
        yield Measure(f"kernels: transmittance, {name}", most(out, np.exp(-before[:-1])), 1e-6)
        yield Measure(
            f"kernels: weights' sum, {name}", abs(float(weighed.sum(dtype=np.float64)) - float(weight.sum())), 1e-6
        )
        two = [np.ascontiguousarray(np.stack([x[0::2], x[1::2]])) for x in (t, tau, share)]
        merged = np.empty((2, n // 2), np.float32)
        depth = probe.probe_merge(2, n // 2, *map(address, two), address(merged))
        # an interval stands in its middle, the first ones at their samples; of two at one place the first
        # segment's # comes first
        near = np.concatenate([two[0][:, :1], two[0][:, :-1]], 1)
        order = np.argsort((near + np.float32(0.5) * (two[0] - near)).reshape(-1), kind="stable")
        exact = np.empty(n)
        exact[order] = np.exp(-np.concatenate([[0], two[1].astype(np.float64).reshape(-1)[order].cumsum()])[:-1])
        yield Measure(f"kernels: merged transmittance, {name}", most(merged.reshape(-1), exact), 1e-6)
        yield Measure(f"kernels: merged optical depth, {name}", abs(depth / before[-1] - 1), 1e-6)
