"""Triangles cut by boxes: what a removal takes away of a street, and what a copy takes along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from unisim_blender.core.geometry import BoolArray, FloatArray, invert_pose
from unisim_blender.core.world.drive import Box

from .atlas import AssetModel


def outside(model: AssetModel, boxes: tuple[Box, ...]) -> AssetModel:
    """What of the model lies in none of the boxes; nothing closes the cuts."""
    for box in boxes:
        model = _split(model, box)[1]
    return model


def inside(model: AssetModel, box: Box) -> AssetModel:
    """What of the model lies in the box."""
    return _split(model, box)[0]


def _split(model: AssetModel, box: Box) -> tuple[AssetModel, AssetModel]:
    """The model inside and outside a box."""
    box_from_model = invert_pose(box.world_from_box)
    half = np.asarray(box.size_m, np.float64) / 2
    local = model.corners @ box_from_model[:3, :3].T + box_from_model[:3, 3]
    apart = ((local > half).all(1) | (local < -half).all(1)).any(1)
    rest, clear = model.of(~apart), [model.of(apart)]
    for axis in range(3):
        for sign in (1.0, -1.0):
            normal = sign * box_from_model[axis, :3]
            offset = half[axis] - sign * box_from_model[axis, 3]
            rest, beyond = _halves(rest, normal, offset)
            clear.append(beyond)
    return rest, _joined(clear)


def _halves(model: AssetModel, normal: FloatArray, offset: float) -> tuple[AssetModel, AssetModel]:
    """The model where ``normal . x <= offset``, and the rest; triangles on both sides are cut in two."""
    distance = model.corners @ normal - offset
    below, above = (distance <= 0).all(1), (distance > 0).all(1)
    mixed = model.of(~below & ~above)
    distance = distance[~below & ~above]
    pieces = [_part_below(mixed, distance, distance <= 0), _part_below(mixed, -distance, distance > 0)]
    return _joined([model.of(below), pieces[0]]), _joined([model.of(above), pieces[1]])


def _part_below(model: AssetModel, distance: FloatArray, kept: BoolArray) -> AssetModel:
    """Of triangles with some corners (F, 3) kept, the part with those: one triangle where one is, two where two are."""
    values = np.concatenate([model.corners, model.normals, model.uv], -1).astype(np.float64)
    single = kept.sum(1) == 1
    lone = np.where(single, kept.argmax(1), (~kept).argmax(1))  # the corner that stands alone on its side
    order = (lone[:, None] + np.arange(3)) % 3
    rows = np.arange(len(values))[:, None]
    values, distance = values[rows, order], distance[rows, order]
    a, b, c = values[:, 0], values[:, 1], values[:, 2]
    to_b = (distance[:, 0] / (distance[:, 0] - distance[:, 1]))[:, None]
    to_c = (distance[:, 0] / (distance[:, 0] - distance[:, 2]))[:, None]
    ab, ac = a + to_b * (b - a), a + to_c * (c - a)
    double = ~single
    cut = np.concatenate(
        [np.stack([a, ab, ac], 1)[single], np.stack([ab, b, c], 1)[double], np.stack([ab, c, ac], 1)[double]]
    ).astype(np.float32)
    source = np.concatenate([np.flatnonzero(single), np.flatnonzero(double), np.flatnonzero(double)])
    return replace(
        model,
        corners=cut[..., :3],
        normals=cut[..., 3:6],
        uv=cut[..., 6:],
        surface=model.surface[source],
        part=model.part[source],
    )


def _joined(models: list[AssetModel]) -> AssetModel:
    names = ("corners", "normals", "uv", "surface", "part")
    return replace(models[0], **{name: np.concatenate([getattr(m, name) for m in models]) for name in names})
