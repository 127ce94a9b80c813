"""What the sidebar says of an actor at the frame that is shown."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ...core.world.drive import Drive
from ...editing.sampled.clock import Clock
from ...editing.sampled.scaling import UNIT, scale_text, size_text
from ..objects.animation import curves_of
from ..objects.imported import is_copy, things
from ..objects.meshes import scale_of, size_of
from ..objects.trajectories import keyed_pose

HALF_S = 0.1
"""Speed is that between so many seconds before and after the frame."""


@dataclass(frozen=True)
class Card:
    """An actor's name and class, what became of it, its speed, how far it is from the ego vehicle, from when to when it is
    there, in seconds of the log, and how large it is, in words."""

    name: str
    label: str
    role: str
    speed_m_s: float
    distance_m: float
    present_s: tuple[float, float] | None
    size: str = ""


def card_of(scene: bpy.types.Scene, thing: bpy.types.Object, drive: Drive) -> Card:
    """Return the card of an actor at the frame that is shown."""
    clock = Clock.of(drive)
    now = float(clock.time_s(np.array(scene.frame_current_final)))
    before, after = clock.frame(np.array([now - HALF_S, now + HALF_S]))
    moved = keyed_pose(thing, float(after))[:3, 3] - keyed_pose(thing, float(before))[:3, 3]
    ego = next(things(scene, "EGO"), None)
    apart = 0.0 if ego is None else (thing.matrix_world.translation - ego.matrix_world.translation).length
    recorded = drive.actors.get(thing.unisim.look or thing.unisim.uid)
    label = thing.unisim.label or (recorded.label if recorded is not None else "")
    return Card(
        thing.name, label, role_of(scene, thing, drive), float(np.linalg.norm(moved)) / (2 * HALF_S), apart,
        present(thing, clock), size_of_card(thing),
    )  # fmt: skip


def size_of_card(thing: bpy.types.Object) -> str:
    """Return how large an actor is drawn, and by what it is scaled, in words."""
    size_m, factors = size_of(thing).tolist(), UNIT if thing.unisim.mesh else scale_of(thing)
    # as long as the sidebar shows at its first width
    return size_text(size_m, digits=2) if factors == UNIT else f"{size_text(size_m, digits=1)} ×{scale_text(factors)}"


def role_of(scene: bpy.types.Scene, thing: bpy.types.Object, drive: Drive) -> str:
    """Return what an actor is in one or two words."""
    if thing.unisim.mesh:
        return "mesh"
    if thing.unisim.uid not in drive.actors or thing.unisim.look_scene:
        return "inserted"
    if is_copy(scene, thing):
        return "copy"
    return "recorded, other appearance" if thing.unisim.look else "recorded"


def present(thing: bpy.types.Object, clock: Clock) -> tuple[float, float] | None:
    """Return from when to when keys show an object, in seconds; None where they never do."""
    hides = [curve for curve in curves_of(thing) if curve.data_path == "hide_viewport"]
    shown = [time for frame, time in zip(clock.frames, clock.times_s, strict=True) if all(c.evaluate(frame) < 0.5 for c in hides)]
    return (float(shown[0]), float(shown[-1])) if shown else None
