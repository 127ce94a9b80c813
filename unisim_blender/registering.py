"""Classes into Blender and out of it."""

from collections.abc import Iterable

import bpy


def add(classes: Iterable[type]) -> None:
    """Register classes in order."""
    for cls in classes:
        bpy.utils.register_class(cls)


def take_away(classes: Iterable[type]) -> None:
    """Unregister classes in the opposite order."""
    for cls in reversed(list(classes)):
        bpy.utils.unregister_class(cls)
