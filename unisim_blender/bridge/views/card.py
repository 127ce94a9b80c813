"""Description of an actor in the sidebar, at the frame that is shown."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.world.drive import Drive
from ...editing.actors.table import HALF_S, ActorCard, present_span, role_words, size_words
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import UNIT
from ..objects.animation import shown_by_keys
from ..objects.imported import imported_objects, is_copy
from ..objects.meshes import scale_of, size_of
from ..objects.trajectories import keyed_pose


def card_of(scene: bpy.types.Scene, obj: bpy.types.Object, drive: Drive) -> ActorCard:
    """Return the card of an actor at the frame that is shown."""
    clock = Clock.of(drive)
    now = float(clock.time_s(np.array(scene.frame_current_final)))
    before, after = clock.frame(np.array([now - HALF_S, now + HALF_S]))
    moved = keyed_pose(obj, float(after))[:3, 3] - keyed_pose(obj, float(before))[:3, 3]
    ego = next(imported_objects(scene, "EGO"), None)
    apart = 0.0 if ego is None else (obj.matrix_world.translation - ego.matrix_world.translation).length
    recorded = drive.actors.get(obj.unisim.look or obj.unisim.uid)
    label = obj.unisim.label or (recorded.label if recorded is not None else "")
    return ActorCard(
        obj.name, label, role_of(scene, obj, drive), float(np.linalg.norm(moved)) / (2 * HALF_S), apart,
        present_span(shown_by_keys(obj, clock.frames), clock), size_of_card(obj),
    )  # fmt: skip


def size_of_card(obj: bpy.types.Object) -> str:
    """Return how large an actor is drawn, and by what it is scaled, in words."""
    return size_words(size_of(obj).tolist(), UNIT if obj.unisim.mesh else scale_of(obj))


def role_of(scene: bpy.types.Scene, obj: bpy.types.Object, drive: Drive) -> str:
    """Return what an actor is in one or two words."""
    about = obj.unisim
    is_recorded = about.uid in drive.actors and not about.look_scene
    return role_words(about.mesh, is_recorded, is_recorded and is_copy(scene, obj), bool(about.look))
