"""Cases of logs: each layout written near its map's origin, and again a million metres off and decades later."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from small_log import small_drive, write_small_log

from unisim_blender.core.data.log import Log
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.world.drive import Drive
from unisim_blender.core.world.replay import DriveStates, parked_boxes

from .measures import Bench, Case, Measure, most

OFF_M = np.array([1e6, -1e6, 500.0])
LATER_S = 2_000_000_000
"""63 years."""
FRAMES = 3
"""So many sweeps of each log are compared."""


def pandaset(folder: Path, far: bool) -> Path:
    drive = small_drive()
    write_small_log(folder, replace(drive, world_origin=drive.world_origin + OFF_M) if far else drive)
    return folder


def ncore(folder: Path, far: bool) -> Path:
    import ncore_by_hand as made

    start = made.START_US + far * LATER_S * 1_000_000
    with patch.multiple(made, ORIGIN=OFF_M if far else np.zeros(3), START_US=start):
        return made.write_by_hand(folder)


def argoverse2(folder: Path, far: bool) -> Path:
    import argoverse2_street as made

    with patch.object(made, "START_NS", made.START_NS + far * LATER_S * 1_000_000_000):
        made.Argoverse2Street(made.CITY + OFF_M if far else made.CITY, sweeps=FRAMES).write(folder)
    return folder


def nuscenes(folder: Path, far: bool) -> Path:
    import nuscenes_street as made

    turned, place = made.MAP
    start = made.START_US + far * LATER_S * 1_000_000
    with patch.multiple(made, MAP=(turned, place + far * OFF_M), START_US=start):
        made.write(folder, traced=False)
    return folder


def kitti(folder: Path, far: bool) -> Path:
    """A million metres of Mercator's map are about six degrees there."""
    import kitti_street as made

    drive = folder / "2011_09_26" / "drive"
    clock = made.CLOCK + np.timedelta64(int(far) * LATER_S, "s")
    with patch.multiple(made, LONGITUDE=made.LONGITUDE + 13.7 * far, ALTITUDE=made.ALTITUDE + far * 500, CLOCK=clock):
        made.write_raw(made.record(drive, 1))
    return drive


def waymo(folder: Path, far: bool) -> Path:
    import waymo_street as made

    start = made.START_US + far * LATER_S * 1_000_000
    with patch.multiple(made, GLOBAL=made.GLOBAL + far * OFF_M, START_US=start):
        made.WaymoStreet(frames=FRAMES).write(folder)
    return folder


LAYOUTS: dict[str, tuple[Callable[[Path, bool], Path], str, float]] = {
    "PandaSet": (pandaset, "", 1e-6),
    "NCore": (ncore, "ncore", 1e-6),
    "Argoverse 2": (argoverse2, "pyarrow", 1e-6),
    "nuScenes": (nuscenes, "", 1e-6),
    "KITTI": (kitti, "", 1e-6),
    "Waymo": (waymo, "pyarrow", 0.1),
}
"""By layout: who writes it, what that needs, and a bound on rays and points in metres. Waymo's files have a pose for each
return in float32, whose steps are 6 cm there."""


def far_logs(layout: str) -> Case:
    """What a reader makes of the same drive near and far, beside where the vehicle is at first."""

    def case(bench: Bench) -> Iterator[Measure]:
        write, _, bound = LAYOUTS[layout]
        near, far = (open_log(write(bench.folder / name, name == "far")) for name in ("near", "far"))
        here, there = near.drive, far.drive
        assert here.frames == there.frames and set(here.actors) == set(there.actors)
        first = here.frames[0]
        start, beyond = (one.world_from_ego.at(one.time_s[first])[:3, 3] for one in (here, there))
        yield Measure("times, s", most([*here.time_s.values()], [*there.time_s.values()]), 1e-6)
        yield Measure("the vehicle, m", most(_track(here), _track(there)), 1e-5)
        for name, camera in here.cameras.items():
            other = there.cameras[name]
            u, v = pixel_grid(camera.model, 8)
            rays, theirs = (camera_rays(one, one.time_s[min(one.time_s)], u, v) for one in (camera, other))
            yield Measure(f"{name}: origins, m", most(rays.origins - start, theirs.origins - beyond), 1e-5)
            yield Measure(f"{name}: directions", most(rays.directions, theirs.directions), 1e-6)
        for name in here.lidars:
            for frame in near.sweep_frames(name)[: FRAMES * bench.full]:
                yield from _sweeps(near, far, name, frame, start, beyond, bound)
        for uid, actor in here.actors.items():
            times = np.linspace(actor.start_s, actor.end_s, 7)
            poses, others = (one.world_from_actor.at(times) for one in (actor, there.actors[uid]))
            yield Measure(f"box {uid}, m", most(poses[:, :3, 3] - start, others[:, :3, 3] - beyond), 1e-5)
        yield from _outside(there)

    return case


def _track(drive: Drive) -> FloatArray:
    times = np.linspace(drive.time_s[drive.frames[0]], drive.time_s[drive.frames[-1]], 101)
    places = drive.world_from_ego.positions_at(times)
    return np.asarray(places - places[0])


def _sweeps(
    near: Log, far: Log, name: str, frame: int, start: FloatArray, beyond: FloatArray, bound: float
) -> Iterator[Measure]:
    a, b = near.sweep(name, frame), far.sweep(name, frame)
    yield Measure(f"{name}: returns that differ in number", float(abs(len(a.points) - len(b.points))), 0)
    if len(a.points) == len(b.points):
        yield Measure(f"{name}: points, m", most(a.points - start, b.points - beyond), bound)
        yield Measure(f"{name}: origins, m", most(a.origins - start, b.origins - beyond), bound)
        yield Measure(f"{name}: times, s", most(a.time_s, b.time_s), 1e-6)


def _outside(drive: Drive) -> Iterator[Measure]:
    """Rays and states hours, days and decades before and after the log: trajectories are carried on."""
    states = DriveStates(drive, parked_boxes(drive))
    for time_s in (-1e9, -1e6, -1e4, 1e4, 1e6, 1e9):
        found = states.state(time_s, time_s + 0.1)
        lost = [actor for actor in found.actors if not np.isfinite(actor.world_from_actor.at(time_s)).all()]
        yield Measure(f"at {time_s:g} s: actors with poses that are not finite", float(len(lost)), 0)
        seen = {name: camera_rays(one, time_s, *pixel_grid(one.model, 16)) for name, one in drive.cameras.items()}
        seen |= {name: lidar_rays(one, time_s) for name, one in drive.lidars.items() if one.model.beams}
        for name, rays in seen.items():
            off = most(np.linalg.norm(rays.directions.reshape(-1, 3), axis=1), 1.0)
            yield Measure(f"at {time_s:g} s, {name}: lengths of directions", off, 1e-9)
            nowhere = float((~np.isfinite(rays.origins)).sum())
            yield Measure(f"at {time_s:g} s, {name}: origins that are not finite", nowhere, 0)
