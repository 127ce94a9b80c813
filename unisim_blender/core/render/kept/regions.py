"""The parts of a standing camera's image that differ from its last one: what boxes that changed cover, or have covered."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...geometry import FloatArray, box_corners, invert_pose
from ...sensors.silhouettes import covered
from ...world.drive import Actor, Camera
from ...world.state import WorldState
from ..regions import Region
from ..visibility import Reach, beside_lines_of_sight
from .changes import Changed

MARGIN_PX = 2
"""Meshes are traced by several rays about a pixel's middle."""
REQUEST_PX = 1024
"""What one more region costs, in pixels."""


def dirty_regions(
    changed: Sequence[Changed], state: WorldState, camera: Camera, pose: FloatArray, reach: Reach, margin: int,
    overhang_m: Callable[[Actor], float],
) -> list[Region]:  # fmt: skip
    """Return the regions outside of which an image has the last one's bits. ``pose`` (4, 4) is where the camera stands,
    ``margin`` how many pixels beside a ray's own depend on it, ``overhang_m`` see `tracer.Backend`."""
    swept = [one.swept(reach, overhang_m(one.actor)) for one in changed]
    # light on meshes is that of the ground about them, on which others may stand
    swept += [one.swept(reach, overhang_m(one.actor)) for one in _lit(changed, swept, state, camera, pose, reach)]
    found = []
    for poses, size in swept:
        part = covered(camera.model, invert_pose(pose) @ poses, size)
        if part is None:
            continue
        low, high = np.floor(part[:2]) - MARGIN_PX - margin, np.ceil(part[2:]) + MARGIN_PX + margin
        # far outside of an image there are no integers
        low, high = np.clip(low, -1, 1 << 30), np.clip(high, -1, 1 << 30)
        region = Region(int(low[0]), int(low[1]), int(high[0]), int(high[1])).within_image(camera.model)
        if region.area:
            found.append(region)
    return joined_where_cheaper(found)


def joined_where_cheaper(regions: Sequence[Region]) -> list[Region]:
    """Return regions that cover others, joined as long as that saves pixels."""
    found: list[Region] = []
    for region in regions:
        grown = True
        while grown:
            grown = False
            for other in found:
                both = region.joined(other)
                if both.area <= region.area + other.area + REQUEST_PX:
                    found.remove(other)
                    region, grown = both, True
                    break
        found.append(region)
    return found


def _lit(
    changed: Sequence[Changed], swept: Sequence[tuple[FloatArray, FloatArray]], state: WorldState, camera: Camera,
    pose: FloatArray, reach: Reach,
) -> list[Changed]:  # fmt: skip
    """Return the meshes whose light can depend on what changed."""
    own = {id(one.actor) for one in changed}
    meshes = [one for one in state.actors if one.appearance.mesh and one.visible_to(camera) and id(one) not in own]
    if not meshes or not changed:
        return []
    found = []
    for mesh in meshes:
        still = Changed(mesh, state.start_s, state.end_s)
        at, size = still.swept(reach, 0.0)
        boxes = [box_corners(one, size)[None, None] for one in at[:1]]
        boxes += [box_corners(one, bounds)[None, None] for poses, bounds in swept for one in poses]
        if beside_lines_of_sight(np.concatenate(boxes), [0], pose[None, :3, 3], reach.light_m)[1:].any():
            found.append(still)
    return found
