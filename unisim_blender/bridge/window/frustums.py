"""How large the frustums of the vehicle's cameras are drawn.

Through one of the cameras, the frustums of the others would cross the image. Blender cannot hide them in one view
without its recorded image, which is drawn with the cameras; so they are drawn tiny as long as some view looks
through a camera.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import bpy

from ..objects.imported import imported_objects

TINY_M = 0.01
"""The smallest size that Blender draws."""
NOTED = "unisim_display_size"
"""A camera's custom property: the size to go back to, in metres."""


def drawn_tiny(through: Iterable[bpy.types.Object | None]) -> bool:
    """Return whether frustums are to be drawn tiny, by the cameras that the views look through (None for no camera)."""
    return any(camera is not None and camera.unisim.kind == "CAMERA" for camera in through)


def to_resize(scene: bpy.types.Scene, tiny: bool) -> bool:
    """Return whether the frustum of some camera has another size than it is to have."""
    return any((NOTED in camera) != tiny for camera in _cameras(scene))


def resize_frustums(scene: bpy.types.Scene, tiny: bool) -> None:
    """Draw the frustums of all cameras of the vehicle tiny, or as large as before."""
    for camera in _cameras(scene):
        if tiny and NOTED not in camera:
            camera[NOTED], camera.display_size = camera.display_size, TINY_M
        elif not tiny and NOTED in camera:
            camera.display_size = camera[NOTED]
            del camera[NOTED]


def _cameras(scene: bpy.types.Scene) -> Iterator[bpy.types.Camera]:
    return (obj.data for obj in imported_objects(scene, "CAMERA"))
