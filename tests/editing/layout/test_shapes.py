"""Shapes of boxes and gizmos, colours of classes, and axes of the speed graph."""

from __future__ import annotations

import numpy as np
import pytest

from unisim_blender.editing.layout.shapes import (
    COLOURS,
    CORNERS,
    HEAD,
    OTHER_COLOUR,
    STEM,
    arrow,
    box_shape,
    class_colour,
    disc,
)
from unisim_blender.editing.layout.speed_graph import BOTTOM, LEFT, RIGHT, WIDTH, GraphAxes
from unisim_blender.editing.layout.trails import sun_lines


def test_a_box_is_closed_and_its_faces_look_outward() -> None:
    vertices, edges, faces = box_shape((4.0, 2.0, 1.5))
    corners = np.array(vertices)
    assert np.ptp(corners[:8], axis=0) == pytest.approx([4.0, 2.0, 1.5]) and corners[:8].mean(0) == pytest.approx(
        np.zeros(3)
    )
    assert np.ptp(corners, axis=0) == pytest.approx([4.0, 2.0, 1.5]), "the arrow is no larger"
    around = [tuple(sorted((face[i], face[(i + 1) % 4]))) for face in faces for i in range(4)]
    assert len(faces) == 6 and len(set(around)) == 12 and all(around.count(edge) == 2 for edge in around)
    for face in faces:
        a, b, c = (corners[i] for i in face[:3])
        assert np.dot(np.cross(b - a, c - b), corners[list(face)].mean(0)) > 0
    tip = corners[10]
    assert tip == pytest.approx([2.0, 0.0, 0.75]) and {i for edge in edges for i in edge} == {8, 9, 10}


def test_gizmos_are_triangles() -> None:
    round_ = np.array(disc()).reshape(-1, 3, 3)
    assert len(round_) == CORNERS and np.linalg.norm(round_[:, 1:], axis=-1) == pytest.approx(np.ones((CORNERS, 2)))
    area = np.linalg.norm(np.cross(round_[:, 1], round_[:, 2]), axis=-1).sum() / 2
    assert area == pytest.approx(np.pi, rel=0.02)
    pointing = np.array(arrow()).reshape(-1, 3, 3)
    assert len(pointing) == 6 and pointing[..., 2].max() == 1.0 and np.abs(pointing[..., :2]).max() == HEAD > STEM
    assert np.abs(pointing[:3, :, 1]).max() == 0 and np.abs(pointing[3:, :, 0]).max() == 0, "flat in two planes"


def test_classes_have_colours() -> None:
    assert class_colour("Medium-sized Truck") == COLOURS["truck"] and class_colour("Pickup Truck") == COLOURS["truck"]
    assert class_colour("Pedestrian with Object") == COLOURS["pedestrian"] and class_colour("Tram") == OTHER_COLOUR
    for label, word in {
        "REGULAR_VEHICLE": "car", "TYPE_VEHICLE": "car", "Van": "car", "vehicle.truck": "truck", "TYPE_CYCLIST": "bicycle",
        "Person_sitting": "pedestrian", "human.pedestrian.adult": "pedestrian", "CONSTRUCTION_CONE": "cone",
    }.items():  # fmt: skip
        assert class_colour(label) == COLOURS[word], label
    assert class_colour("Emergency Vehicle") == class_colour("vehicle.construction") == OTHER_COLOUR


def test_axes_hold_times_and_speeds() -> None:
    axes = GraphAxes(1.0, 5.0, 20.0)
    assert axes.x(np.array([1.0, 5.0])) == pytest.approx([LEFT, WIDTH - RIGHT]) and axes.y(np.array(0.0)) == BOTTOM


def test_lines_to_the_sun_end_where_it_stands_and_where_the_shadow_of_the_box_does() -> None:
    pose, toward = np.eye(4), np.array([0.6, 0.0, 0.8])
    pose[:3, 3] = [10.0, 5.0, 1.0]
    points = sun_lines(pose, np.array([4.0, 2.0, 2.0]), toward).points.reshape(-1, 2, 3)
    np.testing.assert_allclose(points[0], np.array([[10, 5, 1], [14.8, 5, 7.4]]))
    np.testing.assert_allclose(points[-1], np.array([[10, 5, 0], [8.5, 5, 0]]))
    disc = points[1:-1].reshape(-1, 3) - points[0, 1]
    np.testing.assert_allclose(disc @ toward, 0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(disc, axis=1), 0.5)
