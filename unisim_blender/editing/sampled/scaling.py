"""How large an object is drawn: its scale along its own axes, and what of a scale sensors could not be shown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...core.geometry import BoolArray, FloatArray
from ...core.scenario.edits.scale import BOUNDS, scales
from ..texts import Text

SAME_SCALE = 1e-4
"""Within this of 1 an object is as large as it was imported: half a millimetre of a car."""
SAME_SHAPE = 1e-3
"""Axes that lean by less are at right angles, and factors that differ by less are the same throughout."""
DIGITS = 5
"""Of factors: what is drawn in Blender's float32 gives the same ones at every frame."""
MIRRORED, SHEARED, CHANGING = "mirrored", "sheared", "changing"
Factors = tuple[float, float, float]
UNIT: Factors = (1.0, 1.0, 1.0)
WHY = {
    MIRRORED: Text(
        "is mirrored by a negative scale, which cannot be rendered: make its scale, and that of its parent, positive"
    ),
    SHEARED: Text(
        "is sheared by the scale of its parent, which cannot be rendered: clear the parent's scale, or scale it alike "
        "along all axes"
    ),
    CHANGING: Text(
        "has a scale that changes over time, which cannot be rendered: delete the keys of its scale, and what else animates it"
    ),
}


class Scaling(NamedTuple):
    """``factors`` (3,) of an object along its own axes, 1 where it is as large as imported; ``fault`` is why sensors
    cannot be shown it so, a key of `WHY`, or ""."""

    factors: Factors = UNIT
    fault: str = ""


def scaling_of(matrices: FloatArray, poses: FloatArray, there: BoolArray | None = None) -> Scaling:
    """Return the scaling of one object over N frames, from Blender's matrices and the rigid poses of these (N, 4, 4);
    frames at which it is not ``there`` (N,) do not count."""
    some = slice(None) if there is None or not there.any() else there
    drawn, turned = np.asarray(matrices, np.float64)[some, :3, :3], poses[some, :3, :3]
    along = np.swapaxes(turned, -1, -2) @ drawn
    each = np.linalg.norm(drawn, axis=-2)
    x, y, z = np.round(each.mean(0), DIGITS).tolist()
    factors = tuple(1.0 if abs(factor - 1) < SAME_SCALE else factor for factor in (x, y, z))
    fault = ""
    if (np.linalg.det(drawn) < 0).any():
        fault = MIRRORED
    elif (np.abs(along - along * np.eye(3)).max((-2, -1)) > SAME_SHAPE * each.max(-1)).any():
        fault = SHEARED
    elif (np.ptp(each, axis=0) > SAME_SHAPE * each.mean(0)).any():
        fault = CHANGING
    return Scaling((factors[0], factors[1], factors[2]), fault)


def refusal(name: str, scaling: Scaling) -> str:
    """Return why an actor cannot be rendered with a scaling, as a sentence that names it; "" where it can."""
    if scaling.fault:
        return Text('object "{name}": {why}', name=name, why=WHY[scaling.fault])
    if not scales(scaling.factors):
        return Text(
            'object "{name}": is scaled by {factors}; along each axis an actor can be scaled by {least:g} to {most:g}',
            name=name, factors=scale_text(scaling.factors), least=BOUNDS[0], most=BOUNDS[1],
        )  # fmt: skip
    return ""


def scale_text(factors: Sequence[float]) -> str:
    """Return factors in words: one number where they are alike."""
    texts = [f"{factor:.3g}" for factor in factors]
    return texts[0] if len(set(texts)) == 1 else " x ".join(texts)


def size_text(size_m: Sequence[float], digits: int = 1) -> str:
    """Return a box's edges in words."""
    return " x ".join(f"{edge:.{digits}f}" for edge in size_m) + " m"
