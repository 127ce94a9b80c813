"""The compiled planes through nearest points, beside the plain way."""

from __future__ import annotations

import numpy as np
import pytest
from local_planes import local_planes_reference

from unisim_blender.core import native
from unisim_blender.core.errors import SceneError
from unisim_blender.core.render.tracers.surfels.build import Neighbours

needs_kernels = pytest.mark.skipif(native.library() is None, reason="the compiled kernels are not there")


@needs_kernels
@pytest.mark.parametrize(("spread", "most"), [(0.3, 200), (0.3, 12), (0.02, 60), (5.0, 8)])
def test_compiled_planes_are_those_of_the_plain_way(spread: float, most: int) -> None:
    rng = np.random.default_rng(1)
    normal = np.array([0.6, 0.0, 0.8])
    points = rng.normal(size=(1500, 3)) * spread + np.array([40.0, -70, 3])
    points -= np.outer((points - points.mean(0)) @ normal, normal) * 0.95  # nearly a plane
    points = points.astype(np.float32)
    places = np.concatenate([points[:200], points[:50] + np.float32(0.1), rng.normal(size=(5, 3)).astype(np.float32)])
    found = Neighbours(points, 0.25).planes(places, most)
    plain = local_planes_reference(points.astype(np.float64), places.astype(np.float64), 0.25, most)
    np.testing.assert_array_equal(found.number, plain.number)
    np.testing.assert_allclose(found.reach_m, plain.reach_m, atol=1e-5)
    np.testing.assert_allclose(found.rough_m, plain.rough_m, atol=1e-5)
    assert (found.number[-5:] == 0).all() and (found.normal[found.number < 3] == 0).all()
    clear = plain.number > 6
    assert clear.sum() > 30 or spread > 1
    cosine = np.abs((found.normal * plain.normal).sum(1))[clear]
    if not clear.any():
        return
    assert np.median(cosine) > 1 - 1e-6 and (cosine > 0.999).mean() > 0.98, (
        "eigenvalues that nearly agree may give either axis"
    )
    same = np.sign((found.normal * plain.normal).sum(1))[clear] * plain.height_m[clear]
    assert np.median(np.abs(same - found.height_m[clear])) < 1e-6


@needs_kernels
def test_no_points_have_no_planes() -> None:
    found = Neighbours(np.zeros((0, 3), np.float32), 0.2).planes(np.ones((3, 3), np.float32), 8)
    assert (found.number == 0).all() and (found.normal == 0).all() and (found.rough_m == 0).all()
    one = Neighbours(np.ones((1, 3), np.float32), 0.2).planes(np.ones((3, 3), np.float32), 8)
    assert (one.number == 1).all() and (one.reach_m == 0).all()


def test_without_the_kernels_a_sentence_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "library", lambda: None)
    with pytest.raises(SceneError, match="compiled kernels"):
        Neighbours(np.zeros((1, 3), np.float32), 0.2)
