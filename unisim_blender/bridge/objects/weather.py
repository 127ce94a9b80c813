"""The weather and the sun of a scene: settings, animated like any property of Blender's, as a scenario's, and back."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

import bpy
import numpy as np

from ...core.scenario.light import LightSpec, SunSpec
from ...core.scenario.weather import Keyed, ReceiverSpec, ValueKey, WeatherSpec, weather_of
from ...core.world.light import KEYED as SUN_KEYED
from ...core.world.light import SunPosition
from ...core.world.weather import AS_RECORDED_DEG, KEYED
from ...editing.sampled.clock import Clock
from .animation import curves_of
from .imported import collection_of, imported_objects, source_of

CLEAR_M = 1e5
"""Visibility from which there is no fog."""
NONE = {"visibility_m": CLEAR_M, "sun_elevation_deg": AS_RECORDED_DEG}
"""Values, by member, that change nothing, where that is not 0."""
WEATHER, SUN = "unisim_weather", "unisim_sun"
"""Names of the scene's groups of properties."""
LAMP, HEAD_M = "STREET_LAMP", 0.8
"""Kind of the objects that are street lamps, and the width of their heads, metres."""


def weather_and_sun(scene: bpy.types.Scene) -> tuple[object, ...]:
    """Return what the weather, its street lamps and the sun are at the frame that is shown."""
    weather, sun = scene.unisim_weather, scene.unisim_sun
    values = *(getattr(weather, _shown(name)) for name in (*KEYED, "seed")), sun.enabled
    return *values, *(getattr(sun, _shown(name)) for name in SUN_KEYED), street_lamps(scene)


def add_street_lamp(scene: bpy.types.Scene, foot: Sequence[float], height_m: float) -> bpy.types.Object:
    """Return a new street lamp: lines from its foot (3,) to its head, as a mesh, which views through a camera show, too."""
    mesh, across = bpy.data.meshes.new("street lamp"), HEAD_M / 2
    ends = [(-across, 0, height_m), (across, 0, height_m), (0, -across, height_m), (0, across, height_m)]
    mesh.from_pydata([(0, 0, 0), (0, 0, height_m), *ends], [(0, 1), (2, 3), (4, 5)], [])
    obj = bpy.data.objects.new("street lamp", mesh)
    obj.location, obj.unisim.kind = foot, LAMP
    collection_of(scene, LAMP).objects.link(obj)
    return obj


def street_lamps(scene: bpy.types.Scene) -> tuple[tuple[float, float, float], ...]:
    """Return x, y and the height, metres, of a scene's street lamps; those that are hidden in renders are not there."""
    lamps = []
    for obj in imported_objects(scene, LAMP):
        if not obj.hide_render:
            # a scene that is not shown, or a new object, has not been evaluated
            place = obj.matrix_basis if obj.parent is None else obj.matrix_world
            height_m = max((vertex.co.z for vertex in obj.data.vertices), default=0.0) * place.to_scale().z
            x, y, height = (float(f"{value:.7g}") for value in (*place.translation.xy, height_m))
            lamps.append((x, y, height))
    return tuple(lamps)


def scene_weather(scene: bpy.types.Scene) -> WeatherSpec | None:
    """Return the weather that a scene states; None where there is none. What keys animate has a key at each of the
    drive's frames and of Blender's own keys."""
    if not scene.unisim.log:
        return None
    about, clock = scene.unisim_weather, Clock.of(source_of(scene).drive)
    values = {name: _value(scene, WEATHER, name, clock) for name in KEYED}
    stated: dict[str, Any] = {name: value for name, value in values.items() if _changes(name, value)}
    if lamps := street_lamps(scene):
        stated["street_lamps"] = lamps
    if not stated:
        return None
    sensors = ReceiverSpec(**json.loads(about.sensors)) if about.sensors else None
    return WeatherSpec(**stated, seed=about.seed or None, sensors=sensors)


def scene_light(scene: bpy.types.Scene) -> LightSpec | None:
    """Return the sun that a scene states, with keys as `scene_weather` has them; None where it is off."""
    if not scene.unisim.log or not scene.unisim_sun.enabled:
        return None
    clock = Clock.of(source_of(scene).drive)
    return LightSpec(SunSpec(*(_value(scene, SUN, name, clock) for name in SUN_KEYED)))


def _changes(name: str, value: Keyed) -> bool:
    values = {key.value for key in value} if isinstance(value, tuple) else {value}
    return values != {NONE.get(name, 0.0)}


def _shown(name: str) -> str:
    """Return the name of a member's property: Blender has angles in radians, and shows them in degrees."""
    return name.removesuffix("_deg")


def _unit(name: str) -> float:
    return math.degrees(1) if name.endswith("_deg") else 1.0


def _value(scene: bpy.types.Scene, group: str, name: str, clock: Clock) -> Keyed:
    about, shown, unit = getattr(scene, group), _shown(name), _unit(name)
    curve = next((curve for curve in curves_of(scene) if curve.data_path == f"{group}.{shown}"), None)
    if curve is None or not len(curve.keyframe_points):
        return float(f"{getattr(about, shown) * unit:.6g}")  # Blender keeps 32 bits
    frames = np.union1d(clock.frames, np.round([key.co[0] for key in curve.keyframe_points], 3))
    least, most = (getattr(about.bl_rna.properties[shown], end) for end in ("hard_min", "hard_max"))
    at = [float(f"{min(max(curve.evaluate(frame), least), most) * unit:.6g}") for frame in frames]
    times = np.round(clock.time_s(frames), 6)
    return tuple(ValueKey(time_s, value) for time_s, value in zip(times.tolist(), at, strict=True))


def apply_weather(scene: bpy.types.Scene, spec: WeatherSpec | None, clock: Clock) -> None:
    """Give a scene the weather that a scenario states, with keys where it changes. Between a visibility's keys there is
    one at each frame: its reciprocal is linear there."""
    about = scene.unisim_weather
    for name in KEYED:
        value = getattr(spec, name) if spec is not None else None
        if spec is None or not isinstance(value, tuple):
            setattr(about, _shown(name), (NONE.get(name, 0.0) if value is None else value) / _unit(name))
            continue
        frames = clock.frame(np.array([key.time_s for key in value]))
        if name == "visibility_m":
            frames = np.union1d(frames, clock.frames[(clock.frames > frames[0]) & (clock.frames < frames[-1])])
        weather = weather_of(spec)
        _animate(scene, WEATHER, name, frames.tolist(), (weather.value(name, t) for t in clock.time_s(frames).tolist()))
    about.seed = (spec.seed if spec is not None else None) or 0
    sensors = asdict(spec.sensors) if spec is not None and spec.sensors is not None else {}
    stated = {name: value for name, value in sensors.items() if value is not None}
    about.sensors = json.dumps(stated) if stated else ""
    bpy.data.batch_remove(list(imported_objects(scene, LAMP)))
    path = source_of(scene).drive.world_from_ego.positions
    for x, y, height_m in (spec.street_lamps if spec is not None else None) or ():
        nearest = np.linalg.norm(path[:, :2] - [x, y], axis=1).argmin()
        add_street_lamp(scene, (x, y, path[nearest, 2]), height_m)


def apply_light(scene: bpy.types.Scene, spec: LightSpec | None, clock: Clock) -> None:
    """Give a scene the sun that a scenario states, with keys where it changes."""
    scene.unisim_sun.enabled = spec is not None
    if spec is None:
        return
    for name in SUN_KEYED:
        value = getattr(spec.sun, name)
        if isinstance(value, tuple):
            frames = clock.frame(np.array([key.time_s for key in value]))
            _animate(scene, SUN, name, frames.tolist(), (key.value for key in value))
        else:
            setattr(scene.unisim_sun, _shown(name), value / _unit(name))


def show_recorded_sun(scene: bpy.types.Scene, sun: SunPosition) -> None:
    """Turn the sun of a scene, which stays on or off, to where it stood in the recording."""
    scene.unisim_sun.azimuth, scene.unisim_sun.elevation = (
        math.radians(sun.azimuth_deg),
        math.radians(sun.elevation_deg),
    )


def _animate(
    scene: bpy.types.Scene, group: str, name: str, frames: Iterable[float], values: Iterable[float]
) -> None:  # fmt: skip
    path = f"{group}.{_shown(name)}"
    for frame, value in zip(frames, values, strict=True):
        setattr(getattr(scene, group), _shown(name), value / _unit(name))
        scene.keyframe_insert(path, frame=frame)
    for curve in curves_of(scene):
        if curve.data_path == path:
            for key in curve.keyframe_points:
                key.interpolation = "LINEAR"
