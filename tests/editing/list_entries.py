"""Entries of the actor list, made up."""

from __future__ import annotations

from typing import Any

import numpy as np

from unisim_blender.editing.actors.table import Entry


def entry(name: str, **more: Any) -> Entry:
    """Return an entry of a car that stands 10 m away, present for two seconds, but for what is said otherwise."""
    usual: dict[str, Any] = {
        "key": hash(name), "label": "Car", "group": "CAR", "distance_m": 10.0, "speed_m_s": 0.0, "there": True,
        "steps": np.array([[0.0, 2.0]]), "edited": False, "hidden": False,
    }  # fmt: skip
    return Entry(name=name, **{**usual, **more})
