"""What became of meshes that are the ego vehicle's body."""

from __future__ import annotations

from collections.abc import Iterator

from ...core.errors import ScenarioError
from ...core.geometry import invert_pose
from ...core.scenario.edits import EgoBody
from ..sampled.poses import same
from ..sampled.scene import Sampled
from .actors import Relative, new_id
from .trajectories import placement


def body_edits(sampled: Sampled, taken: set[str], relative: Relative) -> Iterator[EgoBody]:
    """Return an edit for each body. Ids go into ``taken``. Raises `ScenarioError` for one that is not fixed to the vehicle."""
    ego = next(sampled.of("EGO"), None)
    for thing in sampled.of("BODY"):
        if not thing.there.any():
            continue
        if ego is None:
            raise ScenarioError(
                f'object "{thing.name}": is a body of the ego vehicle, which is not there: undo that it was deleted'
            )
        mount = invert_pose(ego.poses) @ thing.poses
        if not same(mount, mount[:1]).all():
            raise ScenarioError(
                f'object "{thing.name}": moves on the ego vehicle, which its body is fixed to: keep it parented to the vehicle, '
                "and clear its keys and constraints"
            )
        yield EgoBody(relative(thing.mesh), new_id(thing, taken), placement(mount[0]), thing.label or None)
