"""Frames and sensors as the command line names them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np

from ..data.log import Log
from ..errors import UnisimError
from ..geometry import points_in_box, spread_indices
from ..world.drive import Drive

PANDASET_FRONT_CAMERA = "front_camera"
CAMERA_CLEARANCE_M = 0.3
"""A camera this near to a box stands in it."""
SAME_DIRECTION_RAD = np.radians(5.0)
"""Cameras that look as far aside look in one direction."""
RANGE_PATTERN = re.compile(r"(-?\d*):(-?\d*)(?::(\d*))?")


def select_frames(text: str | None, available: Sequence[int], option: str = "--frames") -> tuple[int, ...]:
    """Those of the ``available`` frame numbers that START:STOP:STEP names, in order; all where ``text`` is None.

    Parts may be left out; START counts from frame 0, STOP is not included, one number alone is that frame, and commas
    join several: "30:80:4", "::2", "42", "3,7,20:30". Frames that are missing are passed over, but at least one must be
    there. Raises `UnisimError`, which names the ``option``.
    """
    if text is None:
        return tuple(available)
    chosen: set[int] = set()
    for part in text.split(","):
        if part.isdecimal():
            chosen.add(int(part))
            continue
        match = RANGE_PATTERN.fullmatch(part)
        step = int(match[3] or 1) if match else 0
        if not match or step < 1:
            raise UnisimError(f'{option} "{text}": must be START:STOP:STEP or frame numbers, with a step of at least 1')
        stop = int(match[2]) if match[2] else max(available, default=0) + 1
        chosen.update(range(int(match[1] or 0), stop, step))
    frames = tuple(frame for frame in available if frame in chosen)
    if not frames:
        span = f"{min(available)} to {max(available)}" if available else "none"
        raise UnisimError(f'{option} "{text}": selects none of the frames there are ({span})')
    return frames


def split_names(text: str | None) -> tuple[str, ...] | None:
    """The names of a comma-separated list; None where ``text`` is None."""
    if text is None:
        return None
    return tuple(name for name in (part.strip() for part in text.split(",")) if name)


def check_names(what: str, names: Iterable[str], known: Iterable[str]) -> None:
    """Raise `UnisimError` for the first name that is not known."""
    known = list(known)
    for name in names:
        if name not in known:
            raise UnisimError(f'{what} "{name}": is not one of {", ".join(known) or "none"}')


def camera_ahead(log: Log) -> str | None:
    """The camera to train on where none is named: PandaSet's `front_camera`, or else of those with images the one that looks
    where the vehicle does. Of several, those in colour come first, then those with more images. None where there is none."""
    there = {name: camera for name, camera in log.drive.cameras.items() if log.image_frames(name)}
    if not there or PANDASET_FRONT_CAMERA in there:
        return PANDASET_FRONT_CAMERA if there else None
    off = {}
    for name, camera in there.items():
        time_s = camera.time_s[log.image_frames(name)[0]]
        ahead, axis = log.drive.world_from_ego.at(time_s)[:3, 0], camera.world_from_camera.at(time_s)[:3, 2]
        off[name] = float(np.arccos(np.clip(ahead @ axis, -1, 1)))
    near = [name for name in there if off[name] < min(off.values()) + SAME_DIRECTION_RAD]
    if len(near) > 1:
        colour = [name for name in near if np.ptp(log.image(name, log.image_frames(name)[0]), axis=-1).any()]
        near = sorted(colour or near, key=lambda name: -len(log.image_frames(name)))
    return near[0]


def training_lidars(log: Log) -> tuple[str, ...]:
    """The log's LiDARs to train on: those that can be simulated, or where there is none, those with sweeps."""
    return beam_lidars(log) or tuple(name for name in log.drive.lidars if log.sweep_frames(name))


def beam_lidars(log: Log) -> tuple[str, ...]:
    """The log's LiDARs that can be simulated and have sweeps: plain points without a beam table are no sensor."""
    return tuple(name for name, lidar in log.drive.lidars.items() if lidar.model.beams and log.sweep_frames(name))


def spread_frames(drive: Drive, count: int, among: Sequence[int] | None = None) -> tuple[int, ...]:
    """``count`` frames of ``among``, evenly spread: of the odd ones, which are not trained on where even ones are,
    where None. Those are left out in which a camera stands in an actor, as one that is moved aside may."""
    free = [frame for frame in drive.frames if not _in_actor(drive, frame)] or list(drive.frames)
    wanted = [frame for frame in free if (frame % 2 if among is None else frame in among)] or free
    return tuple(wanted[place] for place in spread_indices(len(wanted), max(1, count)))


def _in_actor(drive: Drive, frame: int) -> bool:
    for camera in drive.cameras.values():
        if frame in camera.time_s:
            time = camera.time_s[frame]
            place = camera.world_from_camera.at(time)[None, :3, 3]
            for actor in drive.actors.values():
                size = np.asarray(actor.size_m) + 2 * CAMERA_CLEARANCE_M
                if actor.present(time) and points_in_box(place, actor.world_from_actor.at(time), size)[0]:
                    return True
    return False
