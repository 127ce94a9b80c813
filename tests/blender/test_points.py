"""Sweeps in the view: recorded ones where the log is at hand, simulated ones of the scene as it is edited."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from unisim_blender.bridge.things import things


def points(scene: Any) -> NDArray[Any]:
    """The simulated points (N, 3)."""
    (one,) = [t for t in things(scene, "POINTS") if t.unisim.uid.endswith("simulated")]
    out = np.empty(3 * len(one.data.vertices), np.float32)
    one.data.vertices.foreach_get("co", out)
    return out.reshape(-1, 3)


def test_a_simulated_sweep_stands_in_the_world(street: Any) -> None:
    street.frame_set(5)
    assert bpy.ops.unisim.show_points(recorded=False, simulated=True) == {"FINISHED"}
    first = points(street)
    assert len(first) > 5000
    low = np.percentile(first[:, 2], 30)
    assert abs(low) < 1.0  # most of a sweep is road
    mesh = next(t for t in things(street, "POINTS")).data
    assert {"intensity", "depth", "instance"} <= {a.name for a in mesh.attributes}
    street.frame_set(12)
    assert np.abs(points(street).mean(0) - first.mean(0)).max() > 0.5
    assert bpy.ops.unisim.show_points(recorded=False, simulated=False) == {"FINISHED"}
    assert not list(things(street, "POINTS"))
