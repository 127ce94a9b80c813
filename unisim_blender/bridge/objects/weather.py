"""The weather of a scene: its settings, animated like any property of Blender's, as a scenario's, and back."""

from __future__ import annotations

import json
from dataclasses import asdict

import bpy
import numpy as np

from ...core.scenario.weather import ReceiverSpec, ValueKey, WeatherSpec, weather_of
from ...core.world.weather import KEYED
from ...editing.sampled.clock import Clock
from .animation import curves_of
from .imported import source_of

CLEAR_M = 1e5
"""Visibility from which there is no fog."""
NONE = {"visibility_m": CLEAR_M}
"""Values, by member, that change nothing, where that is not 0."""


def weather_path(name: str) -> str:
    """Return the data path of a member of the weather."""
    return f"unisim_weather.{name}"


def weather_values(scene: bpy.types.Scene) -> tuple[float, ...]:
    """Return what the weather is at the frame that is shown."""
    return tuple(getattr(scene.unisim_weather, name) for name in (*KEYED, "seed"))


def scene_weather(scene: bpy.types.Scene) -> WeatherSpec | None:
    """Return the weather that a scene states; None where there is none. What keys animate has a key at each of the
    drive's frames and of Blender's own keys."""
    if not scene.unisim.log:
        return None
    about, clock = scene.unisim_weather, Clock.of(source_of(scene).drive)
    values = {name: _value(scene, name, clock) for name in KEYED}
    stated = {name: value for name, value in values.items() if value is not None}
    if not stated:
        return None
    sensors = ReceiverSpec(**json.loads(about.sensors)) if about.sensors else None
    return WeatherSpec(**stated, seed=about.seed or None, sensors=sensors)


def _value(scene: bpy.types.Scene, name: str, clock: Clock) -> float | tuple[ValueKey, ...] | None:
    clear = NONE.get(name, 0.0)
    curve = next((curve for curve in curves_of(scene) if curve.data_path == weather_path(name)), None)
    if curve is None or not len(curve.keyframe_points):
        value = float(f"{getattr(scene.unisim_weather, name):.6g}")  # Blender keeps 32 bits
        return None if value == clear else value
    frames = np.union1d(clock.frames, np.round([key.co[0] for key in curve.keyframe_points], 3))
    least, most = (getattr(scene.unisim_weather.bl_rna.properties[name], end) for end in ("hard_min", "hard_max"))
    at = [float(f"{min(max(curve.evaluate(frame), least), most):.6g}") for frame in frames]
    if set(at) == {clear}:
        return None
    times = np.round(clock.time_s(frames), 6)
    return tuple(ValueKey(time_s, value) for time_s, value in zip(times.tolist(), at, strict=True))


def apply_weather(scene: bpy.types.Scene, spec: WeatherSpec | None, clock: Clock) -> None:
    """Give a scene the weather that a scenario states, with keys where it changes. Between a visibility's keys there is
    one at each frame: its reciprocal is linear there."""
    about = scene.unisim_weather
    for name in KEYED:
        value = getattr(spec, name) if spec is not None else None
        if not isinstance(value, tuple):
            setattr(about, name, NONE.get(name, 0.0) if value is None else value)
            continue
        frames = clock.frame(np.array([key.time_s for key in value]))
        if name == "visibility_m":
            frames = np.union1d(frames, clock.frames[(clock.frames > frames[0]) & (clock.frames < frames[-1])])
        weather = weather_of(spec) if spec is not None else None
        for frame, time_s in zip(frames.tolist(), clock.time_s(frames).tolist(), strict=True):
            now = weather.value(name, time_s) if weather is not None else 0.0
            setattr(about, name, now)
            scene.keyframe_insert(weather_path(name), frame=frame)
        for curve in curves_of(scene):
            if curve.data_path == weather_path(name):
                for key in curve.keyframe_points:
                    key.interpolation = "LINEAR"
    about.seed = (spec.seed if spec is not None else None) or 0
    sensors = asdict(spec.sensors) if spec is not None and spec.sensors is not None else {}
    stated = {name: value for name, value in sensors.items() if value is not None}
    about.sensors = json.dumps(stated) if stated else ""
