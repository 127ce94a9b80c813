"""Edges of boxes through lenses: straight where the lens is a pinhole, and on the lens's own curve where it is not."""

from __future__ import annotations

import numpy as np

from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.sensors.silhouettes import BOX_EDGES as EDGES
from unisim_blender.core.sensors.silhouettes import PIECES as STEPS
from unisim_blender.core.sensors.silhouettes import bent_edges
from unisim_blender.core.world.drive import CameraModel
from unisim_blender.editing.sensors.lenses import corners

BOX = corners(np.array([-1.0, -0.5, 3.0]), np.array([1.0, 0.5, 6.0]))
PLAIN = CameraModel(200, 100, 80.0, 80.0, 100.0, 50.0)
WIDE = CameraModel(200, 100, 80.0, 80.0, 100.0, 50.0, lens=OpenCVFisheye(k1=-0.05))


def test_a_box_has_twelve_edges_along_its_axes() -> None:
    assert len(EDGES) == 12 and len({tuple(edge) for edge in EDGES.tolist()}) == 12
    along = BOX[EDGES[:, 1]] - BOX[EDGES[:, 0]]
    assert ((along != 0).sum(1) == 1).all()
    assert sorted(np.abs(along).sum(1)) == [1.0] * 4 + [2.0] * 4 + [3.0] * 4


def test_edges_are_straight_through_a_pinhole_and_bent_through_a_fisheye() -> None:
    for model, bent in ((PLAIN, False), (WIDE, True)):
        segments = bent_edges(model, np.eye(4), BOX)
        assert segments.shape == (12 * STEPS, 2, 2)
        edges = segments.reshape(12, STEPS, 2, 2)
        np.testing.assert_array_equal(edges[:, 1:, 0], edges[:, :-1, 1])
        first, last, middle = edges[:, 0, 0], edges[:, -1, 1], edges[:, STEPS // 2, 0]
        chord, to = last - first, middle - first
        off = np.abs(chord[:, 0] * to[:, 1] - chord[:, 1] * to[:, 0]) / np.linalg.norm(chord, axis=1)
        assert (off.max() > 0.3) == bent and (bent or off.max() < 1e-9)


def test_points_of_edges_look_where_the_lens_shows_them() -> None:
    """Each end's ray through the lens meets an edge of the box."""
    ends = bent_edges(WIDE, np.eye(4), BOX).reshape(-1, 2)
    rays = WIDE.unproject(ends[:, 0], ends[:, 1])
    away = np.full(len(rays), np.inf)
    for a, b in BOX[EDGES]:
        normal = np.cross(rays, b - a)
        away = np.minimum(away, np.abs((normal @ a) / np.linalg.norm(normal, axis=1)))
    assert away.max() < 1e-6


def test_what_lies_outside_the_image_or_the_domain_is_left_out() -> None:
    behind = np.diag([1.0, 1.0, -1.0, 1.0])
    assert not len(bent_edges(PLAIN, behind, BOX))
    beside = np.eye(4)
    beside[1, 3] = 3.0
    part = bent_edges(WIDE, beside, BOX)
    assert 0 < len(part) < 12 * STEPS
    assert (part >= 0).all() and (part <= [200, 100]).all()
