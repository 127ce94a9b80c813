"""Lamps of actors: settings of a scene, keyed like any property of Blender's, as a scenario's edits, and back."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from math import inf

import bpy
import numpy as np

from ...core.scenario.edits import Lamp
from ...core.world.lamps import STATES, ActorLamp
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import LampSetting
from .animation import curves_of
from .imported import imported_objects, title_of

SETTINGS = ("recorded", *STATES)
"""What a lamp can be set to, in the order of Blender's numbers."""


def lamp_id(obj: bpy.types.Object) -> str:
    """Return the id by which a scene's lamps name an actor's object."""
    return str(obj.unisim.uid if obj.name == obj.unisim.home else title_of(obj))


def lamp_settings(scene: bpy.types.Scene) -> tuple[LampSetting, ...]:
    """Return what a scene's lamps are set to, without those that are as recorded."""
    settings: list[LampSetting] = []
    for number, lamp in enumerate(scene.unisim_lamps):
        path = f"unisim_lamps[{number}].state"
        points = [key.co for curve in curves_of(scene) if curve.data_path == path for key in curve.keyframe_points]
        keys = [(float(frame), SETTINGS[round(value)]) for frame, value in points] or [(-inf, lamp.state)]
        starts = [-inf, *(frame for frame, _ in keys[1:]), inf]
        for (_, state), first, end in zip(keys, starts[:-1], starts[1:], strict=True):
            setting = LampSetting(lamp.actor, lamp.name, state, first, end)
            if settings and settings[-1] == setting._replace(first=settings[-1].first, end=first):  # keyed once more
                setting = setting._replace(first=settings.pop().first)
            settings.append(setting)
    return tuple(setting for setting in settings if setting.state != "recorded")


def put_lamps(scene: bpy.types.Scene, recorded: Mapping[str, tuple[ActorLamp, ...]]) -> None:
    """Add the lamps of a log's actors, by their ids, to a scene's for each of their objects; what these are set to stays."""
    for obj in imported_objects(scene, "ACTOR"):
        for lamp in () if obj.unisim.look or obj.unisim.mesh else recorded.get(obj.unisim.uid, ()):
            same = [item for item in scene.unisim_lamps if item.actor == lamp_id(obj) and item.name in (lamp.name, "")]
            item = same[0] if same else scene.unisim_lamps.add()
            item.actor, item.name = lamp_id(obj), lamp.name
            spans = zip(lamp.shown, lamp.times_s.tolist(), strict=True)
            item.recorded = json.dumps([(lamp.states[state], time_s) for state, time_s in spans])


def apply_lamps(scene: bpy.types.Scene, edits: Iterable[Lamp], clock: Clock) -> None:
    """Set a scene's lamps as the edits of a scenario do, with keys where that changes."""
    lamps: dict[int, ActorLamp] = {}
    for edit in edits:
        items = [(item.actor, item.name) for item in scene.unisim_lamps]
        number = next((n for n, (uid, name) in enumerate(items) if uid == edit.actor and edit.lamp in (None, name)), -1)
        if number < 0:
            number, item = len(items), scene.unisim_lamps.add()
            item.actor, item.name = edit.actor, edit.lamp or ""
        before = lamps.get(number, ActorLamp("", SETTINGS, np.array([-inf]), np.zeros(1, np.int64), ()))
        span = -inf if edit.from_s is None else edit.from_s, inf if edit.to_s is None else edit.to_s
        lamps[number] = before.switched(edit.state, *span)
    for number, lamp in lamps.items():
        item, moments = scene.unisim_lamps[number], lamp.times_s[lamp.times_s < inf]
        for time_s, state in zip(np.maximum(moments, clock.times_s[0]), lamp.shown, strict=False):
            item.state = SETTINGS[state]
            if len(moments) > 1:
                scene.keyframe_insert(f"unisim_lamps[{number}].state", frame=float(clock.frame(time_s)))
        item.state = SETTINGS[lamp.at(float(clock.time_s(np.array(scene.frame_current)))).shown[0]]
