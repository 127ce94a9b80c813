"""Colours of surfels from recorded images, and of what lies beyond all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....data.ground import fill
from ....geometry import BoolArray, FloatArray, invert_pose, transform_points
from ....sensors.silhouettes import spheres_in_cone, view_half_angle
from .cloud import cube_keys, summed
from .exposure import Observations, exposure_gains
from .model import SurfelSet
from .placed import PlacedSurfels
from .views import RecordedView

FACE_TILE_M = 8.0
"""Edge, metres, of the cubes by which static faces are culled."""
DOME_CELL_DEG = 0.2
"""Edge of the dome's cells, degrees."""
FILL_CUBE_EDGES_M = (0.3, 1.0, 4.0, 20.0)
"""Edges of cubes, metres: a face that no image shows has the mean colour of its cube, or of the next larger one where
nothing in that was painted."""
FARTHEST_M = 150.0
FACE_STRIDE = 8
"""Stride through the static faces that images are compared at to estimate their exposures."""


@dataclass
class _Canvas:
    """Corners (F, 3, 3) of a set that is being painted, and the quality of each face's best view so far."""

    faces: SurfelSet
    corners: FloatArray
    centres: FloatArray
    best: NDArray[np.float32]
    image: NDArray[np.int16]
    """Number of the image from which each face was painted."""

    @staticmethod
    def of(faces: SurfelSet) -> _Canvas:
        corners = faces.vertices.reshape(-1, 3, 3).astype(np.float64)
        return _Canvas(
            faces, corners, corners.mean(1), np.zeros(len(faces), np.float32), np.zeros(len(faces), np.int16)
        )


class SurfelPainter:
    """Paints the sets of placed surfels, in place, with one image after the other; each face is left with the colours
    of the image that showed it largest, as if all images were exposed alike."""

    def __init__(self, surfels: PlacedSurfels) -> None:
        self.surfels = surfels
        self.static = _Canvas.of(surfels.static)
        self.placed = [_Canvas.of(faces) for _, faces in surfels.placed]
        cube = (
            np.floor(self.static.centres / FACE_TILE_M).astype(np.int64)
            if len(surfels.static)
            else np.zeros((0, 3), np.int64)
        )
        self.tiles, self.tile_of = np.unique(cube, axis=0, return_inverse=True)
        self.order = np.argsort(self.tile_of.reshape(-1), kind="stable")
        self.starts = np.searchsorted(self.tile_of.reshape(-1)[self.order], np.arange(len(self.tiles) + 1))
        rows, columns = round(180 / DOME_CELL_DEG), round(360 / DOME_CELL_DEG)
        self._shape = rows, columns
        self._beyond: list[tuple[NDArray[np.int32], NDArray[np.uint8]]] = []
        self._observations: list[Observations] = []
        self._images = 0

    def paint(self, view: RecordedView) -> None:
        """Paint the faces that an image shows."""
        chosen = self._in_sight(view)
        self._faces(view, self.static, chosen, view.of_static, True)
        first, last = view.ends()
        for (actor, _), canvas in zip(self.surfels.placed, self.placed, strict=True):
            trajectory = actor.world_from_actor
            there = actor.start_s <= min(first, last) and max(first, last) <= actor.end_s and len(canvas.faces)
            if there and _in_frustum(view, trajectory.at(first)[None, :3, 3], float(np.linalg.norm(actor.size_m)))[0]:
                self._faces(
                    view,
                    canvas,
                    np.arange(len(canvas.faces)),
                    lambda points, trajectory=trajectory: view.of_actor(trajectory, points),
                    False,
                )
        u, v, directions = view.far_points()
        cell = dome_cell(directions, self._shape).astype(np.int32)
        self._beyond.append((cell, np.rint(view.sample(u, v)).astype(np.uint8)))
        self._images += 1

    def gains(self) -> FloatArray:
        """Return the exposures (images, 3) of the images so far, in their order."""
        parts = [(seen.place, seen.image, seen.colour) for seen in self._observations]
        if not parts:
            return np.ones((self._images, 3))
        return exposure_gains(Observations(*(np.concatenate(part) for part in zip(*parts, strict=True))), self._images)

    def dome(self, gains: FloatArray) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Return colours (rows, columns, 3) by direction, and where (rows, columns) images showed them; elsewhere they
        are those beside."""
        total = np.zeros((self._shape[0] * self._shape[1], 4))
        for gain, (cell, colour) in zip(gains, self._beyond, strict=True):
            for k in range(3):
                total[:, k] += np.bincount(cell, colour[:, k] / gain[k], len(total))
            total[:, 3] += np.bincount(cell, minlength=len(total))
        seen = total[:, 3] > 0
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = total[:, :3] / total[:, 3:]
        if not seen.any():
            mean[:] = 128.0
        colours = fill(mean.reshape(*self._shape, 3))
        return np.clip(np.rint(colours), 0, 255).astype(np.uint8), seen.reshape(self._shape)

    def finish(self, gains: FloatArray) -> None:
        """Divide colours by the images' exposures, and give faces that no image showed the colours around them."""
        for canvas in (self.static, *self.placed):
            painted = canvas.faces.painted
            even = canvas.faces.colours[painted] / gains[canvas.image[painted], None]
            canvas.faces.colours[painted] = np.clip(np.rint(even), 0, 255).astype(np.uint8)
            _spread(canvas)

    def _in_sight(self, view: RecordedView) -> NDArray[np.int64]:
        """Return static faces in cubes that the image can show."""
        if len(self.tiles) == 0:
            return np.zeros(0, np.int64)
        inside = _in_frustum(view, (self.tiles + 0.5) * FACE_TILE_M, FACE_TILE_M * np.sqrt(3) / 2 + 1)
        return np.concatenate(
            [np.zeros(0, np.int64), *(self.order[self.starts[i] : self.starts[i + 1]] for i in np.flatnonzero(inside))]
        )

    def _faces(self, view: RecordedView, canvas: _Canvas, chosen: NDArray[np.int64], place: Any, static: bool) -> None:
        u, v, z, distance = place(canvas.centres[chosen])
        model = view.camera.model
        inside = view.inside(u, v, z)
        chosen, u, v, distance = chosen[inside], u[inside], v[inside], distance[inside]
        # how large the face is in the image: its own normal against the ray, over the square of the distance
        ends = place(canvas.centres[chosen] + 0.01 * canvas.faces.normals[chosen])
        sine = np.hypot(ends[0] - u, ends[1] - v) / model.pixels_per_rad * distance / 0.01
        frontal = np.sqrt(np.clip(1 - sine**2, 0.0, 1)) + 0.02
        score = (frontal / np.maximum(distance, 1.0) ** 2).astype(np.float32)
        if static:
            self._observe(view, chosen, u, v, distance)
        middle_u, middle_v = u, v
        better = (score > canvas.best[chosen]) & (ends[3] < distance)
        better[better] = view.sees(u[better], v[better], distance[better], static)
        chosen = chosen[better]
        canvas.best[chosen] = score[better]
        corners = canvas.corners[chosen].reshape(-1, 3)
        u, v, _, _ = place(corners)
        if not model.is_pinhole:
            # a corner beyond what the lens shows has its face's colour
            u, v = (
                np.where(np.isnan(at), np.repeat(middle[better], 3), at)
                for at, middle in ((u, middle_u), (v, middle_v))
            )
        canvas.faces.colours[chosen] = np.rint(view.sample(u, v)).astype(np.uint8).reshape(-1, 3, 3)
        canvas.faces.painted[chosen] = True
        canvas.image[chosen] = self._images

    def _observe(
        self, view: RecordedView, chosen: NDArray[np.int64], u: FloatArray, v: FloatArray, distance: FloatArray
    ) -> None:
        """Note an image's colours of faces ``chosen`` (N,) at image points u, v (N,), at ``distance`` (N,), metres."""
        some = np.flatnonzero(chosen % FACE_STRIDE == 0)
        some = some[view.sees(u[some], v[some], distance[some], True)]
        number = np.full(len(some), self._images)
        self._observations.append(Observations(chosen[some], number, view.sample(u[some], v[some])))


def _in_frustum(view: RecordedView, middles: FloatArray, radius_m: float) -> BoolArray:
    """Return which spheres of ``radius_m`` around ``middles`` (N, 3), world frame, an image can show: (N,) bool."""
    local = transform_points(invert_pose(view.camera.world_from_camera.at(view.camera.time_s[view.frame])), middles)
    model = view.camera.model
    if not model.is_pinhole:
        near = np.linalg.norm(local, axis=1) < FARTHEST_M
        return near & spheres_in_cone(local, np.full(len(local), radius_m), view_half_angle(model, 0.0))
    inside = (local[:, 2] > -radius_m) & (np.linalg.norm(local, axis=1) < FARTHEST_M)
    for axis, focal, centre, size in ((0, model.fx, model.cx, model.width), (1, model.fy, model.cy, model.height)):
        for edge, sign in ((0.0, 1.0), (float(size), -1.0)):
            slope = (centre - edge) / focal
            inside &= sign * (local[:, axis] + slope * local[:, 2]) / np.hypot(1, slope) > -radius_m
    return np.asarray(inside)


def _spread(canvas: _Canvas) -> None:
    painted = canvas.faces.painted
    if painted.all() or not painted.any():
        return
    colours = canvas.faces.colours[painted].mean(1)
    missing = np.flatnonzero(~painted)
    for edge in FILL_CUBE_EDGES_M:
        key, total = summed(
            cube_keys(canvas.centres[painted], edge), np.concatenate([colours, np.ones((len(colours), 1))], 1)
        )
        wanted = cube_keys(canvas.centres[missing], edge)
        at = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        has_mean = key[at] == wanted
        mean = total[at[has_mean], :3] / total[at[has_mean], 3:]
        canvas.faces.colours[missing[has_mean]] = np.rint(mean).astype(np.uint8)[:, None]
        missing = missing[~has_mean]


def dome_cell(directions: FloatArray, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the cells (N,) of unit directions (N, 3) in a dome (rows from the zenith down, columns counter-clockwise
    from x)."""
    rows, columns = shape[:2]
    row = np.arccos(np.clip(directions[:, 2], -1, 1)) / np.pi * rows
    column = np.arctan2(directions[:, 1], directions[:, 0]) / (2 * np.pi) % 1.0 * columns
    return np.minimum(row.astype(np.int64), rows - 1) * columns + np.minimum(column.astype(np.int64), columns - 1)


def dome_colours(dome: NDArray[np.uint8], directions: FloatArray) -> NDArray[np.float32]:
    """Return colours (N, 3) in 0..1 of a dome (rows, columns, 3) in unit directions (N, 3), world frame, bilinear."""
    rows, columns = dome.shape[:2]
    y = np.clip(np.arccos(np.clip(directions[:, 2], -1, 1)) / np.pi * rows - 0.5, 0, rows - 1)
    x = np.arctan2(directions[:, 1], directions[:, 0]) / (2 * np.pi) * columns - 0.5
    row, column = np.minimum(y.astype(np.int64), rows - 2), np.floor(x).astype(np.int64)
    fy, fx = (y - row).astype(np.float32)[:, None], (x - column).astype(np.float32)[:, None]
    left, right = column % columns, (column + 1) % columns
    top = dome[row, left] * (1 - fx) + dome[row, right] * fx
    bottom = dome[row + 1, left] * (1 - fx) + dome[row + 1, right] * fx
    return np.asarray((top * (1 - fy) + bottom * fy) / 255, np.float32)
