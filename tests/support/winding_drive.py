"""A winding road with free lanes: an ego that brakes and speeds up, cars beside and before it, and a pedestrian."""

from __future__ import annotations

import numpy as np

from unisim_blender.core.geometry import FloatArray, Trajectory, quaternion_from_yaw
from unisim_blender.core.world.drive import Actor, Appearance, Drive

TIMES = np.linspace(0.0, 10.0, 101)
LENGTHS = np.linspace(0.0, 300.0, 3001)
HEADINGS = 0.35 * np.sin(LENGTHS / 25)
ROAD = np.cumsum(np.stack([np.cos(HEADINGS), np.sin(HEADINGS), 0.02 * np.ones_like(HEADINGS)], -1) * 0.1, axis=0)


def on_road(gone: FloatArray, left: float, up: float, noise_m: float = 0.0) -> Trajectory:
    """A trajectory beside the road's middle at arc lengths."""
    heading = np.interp(gone, LENGTHS, HEADINGS)
    places = np.stack([np.interp(gone, LENGTHS, column) for column in ROAD.T], -1)
    places = places + left * np.stack([-np.sin(heading), np.cos(heading), 0 * heading], -1) + [0.0, 0.0, up]
    places[:, :2] += np.random.default_rng(3).normal(0.0, noise_m, (len(gone), 2))
    return Trajectory(TIMES, places, quaternion_from_yaw(heading))


def actor(uid: str, label: str, size: tuple[float, float, float], trajectory: Trajectory) -> Actor:
    return Actor(uid, label, np.array(size), trajectory, -1.0, 11.0, True, Appearance(uid))


def winding_drive() -> Drive:
    """An ego that brakes and speeds up, cars in the lanes beside and before it, annotated to 3 cm, and a pedestrian."""
    ego = 20 + 9 * TIMES + 3 * np.sin(TIMES / 2)
    actors = [
        actor("near", "Car", (4.4, 1.9, 1.5), on_road(ego + 9 + 0.4 * TIMES, 3.6, 0.75, 0.03)),
        actor("right", "Car", (4.6, 1.8, 1.4), on_road(ego + 3 + 1.2 * TIMES, -3.4, 0.7, 0.03)),
        actor("ahead", "Bus", (11.0, 2.5, 3.0), on_road(95 + 8 * TIMES, 0.0, 1.5, 0.03)),
        actor("walker", "Pedestrian", (0.6, 0.6, 1.7), on_road(30 + 1.3 * TIMES, 12.0, 0.85, 0.02)),
    ]
    frames = tuple(range(len(TIMES)))
    time_s = dict(zip(frames, TIMES.tolist(), strict=True))
    return Drive("winding", frames, time_s, on_road(ego, 0.0, 0.0), {}, {}, {a.uid: a for a in actors})
