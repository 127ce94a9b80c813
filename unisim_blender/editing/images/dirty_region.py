"""The part of an image that an edit can change (its dirty region): what shows no box that changed is
the same as before."""

from __future__ import annotations

import numpy as np

from ...core.geometry import FloatArray, invert_pose
from ...core.sensors.silhouettes import covered
from ...core.world.drive import CameraModel
from ..sampled.poses import optical
from ..sampled.scene import Sampled, SampledObject

MARGIN_PX = 2
"""A pixel is hit by rays about its middle; the renderer knows how far its decoder carries them."""
TOLD = ("kind", "uid", "appearance", "appearance_scene", "model", "camera", "size_m", "mesh", "sees_body", "scaling")
"""What of an object, beside where it is, says how it looks."""

Rectangle = tuple[int, int, int, int]
"""Left, top, right, bottom in pixels from the top left corner; right and bottom do not belong to it."""


def dirty_region(
    before: Sampled, after: Sampled, view: SampledObject, model: CameraModel, beside_m: float = 0.1
) -> Rectangle | None:
    """Return the part of ``view``'s image whose rays see the difference between two states of a scene at the same
    frames; None where all of it may.

    ``beside_m`` is how far beside a box it may still show. An empty rectangle means that nothing differs.
    """
    if not np.array_equal(before.clock.times_s, after.clock.times_s) or before.items != after.items:
        return None
    old, new = ({obj.name: obj for obj in state.objects} for state in (before, after))
    rectangle: Rectangle | None = (model.width, model.height, 0, 0)
    for name in sorted({*old, *new}):
        states = [obj for obj in (old.get(name), new.get(name)) if obj is not None]
        if len(states) == 2 and alike(*states):
            continue
        if name == view.name:
            return None
        for obj in states:
            if obj.kind in ("CAMERA", "LIDAR", "EGO", "NONE"):
                continue  # what looks is not seen
            if obj.kind == "BODY" and not view.sees_body:
                continue
            if obj.kind not in ("ACTOR", "BODY") or rectangle is None:
                return None
            if obj.there.any():
                rectangle = joined(rectangle, _seen(obj, view, model, beside_m))
    return rectangle


def alike(a: SampledObject, b: SampledObject) -> bool:
    """Whether two states of an object look the same."""
    told = all(getattr(a, name) == getattr(b, name) for name in TOLD)
    return told and np.array_equal(a.poses, b.poses) and np.array_equal(a.there, b.there)


def _seen(obj: SampledObject, view: SampledObject, model: CameraModel, beside_m: float) -> Rectangle:
    """What a box covers of the image, wherever box and camera are at the frames."""
    size: FloatArray = np.array(obj.size_m) * 1.1 + 2 * beside_m
    poses = np.concatenate([invert_pose(camera) @ obj.poses for camera in optical(view.poses)])
    part = covered(model, poses, size)
    if part is None:
        return model.width, model.height, 0, 0
    left, right = np.clip([part.left - MARGIN_PX, part.right + MARGIN_PX], 0, model.width)
    top, bottom = np.clip([part.top - MARGIN_PX, part.bottom + MARGIN_PX], 0, model.height)
    return int(left), int(top), int(np.ceil(right)), int(np.ceil(bottom))


def is_empty(part: Rectangle) -> bool:
    """Whether there is nothing in it."""
    return part[0] >= part[2] or part[1] >= part[3]


def joined(a: Rectangle, b: Rectangle | None) -> Rectangle | None:
    """The rectangle about two, of which either may be empty; None where the second is all."""
    if b is None:
        return None
    if is_empty(b) or is_empty(a):
        return a if is_empty(b) else b
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])
