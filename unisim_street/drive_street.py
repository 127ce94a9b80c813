"""The street that a drive goes through, with the streets that its inserted actors come from."""

from __future__ import annotations

from collections.abc import Mapping

from unisim_blender.core.scenes.scene import Scene

from .street import Street, load_street


def street_of(street: Street, others: Mapping[str, Scene]) -> Street:
    """Return the street with those of the scenes that actors were inserted from, by their names in `Appearance`. Raises
    `UnisimError`."""
    for name, scene in others.items():
        street = street.with_scene(name, load_street(scene.header.log_path))
    return street
