"""Edits that no real drive would show: overlaps, cars sideways, too fast or beyond the limits of motion, actors off the
ground or of odd sizes, views from far away; and how high the ground is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...core.actor_images.names import group_of
from ...core.geometry import BoolArray, FloatArray, box_corners, invert_pose, transform_points
from ...core.world.classes import motion_of
from ...core.world.drive import Drive
from ..sampled.clock import Clock, recorded_poses, recorded_there
from ..sampled.scene import WHY, Sampled, SampledObject, Scaling, differs, scale_text
from ..sampled.source import DriveSource
from ..sensors.lenses import degrees_across
from ..texts import Text, kmh, translatable
from .kinematics import Limits, ObjectTrack, compared, describe, is_limited, label_of

SIDEWAYS_RAD = np.radians(25)
MOVING_M_S = 1.5
"""Slower than this, annotations' noise is larger than the motion."""
FASTEST_M_S = {"PERSON": 8.0, "CYCLE": 18.0, "CAR": 70.0, "TRUCK": 45.0, "OTHER": 70.0}
"""By the group of a class."""
FASTEST_STILL_M_S = 0.5
"""Of classes that stand where they are."""
OFF_GROUND_M = 0.5
FAR_VIEW_M = 3.0
ASIDE_SHARE = 0.5
"""Of what a camera sees, sideways: how much may lie beyond what any camera recorded."""
SPEED_TOLERANCE, SPEED_NOISE_M_S = 1.25, 0.3
"""By how much a walker's speed may differ from what was recorded: a factor, and what annotations' noise makes of it."""
PLAUSIBLE_EXTENT_M = 0.05, 100.0
"""Of a mesh actor: beyond it, its file may have another unit."""
PLAUSIBLE_SCALE = 0.5, 2.0
"""Of what was recorded: an actor that is smaller or larger is told."""
MOST_NAMED = 3
OVERLAP_M = 0.1
"""Boxes are drawn generously: less than this is no collision."""


@dataclass(frozen=True)
class Finding:
    """Sentence on an object that is not plausible, and where to look."""

    name: str
    frame: int
    text: str


def warnings_of(
    sampled: Sampled, drive: Drive, limits: Limits | None = None, is_trained: bool = True
) -> Iterator[Finding]:
    """Yield what is not plausible in a sampled scene, as findings. What stands as recorded is taken as it is.

    ``limits`` are those of motion; the default ones where it is None. ``is_trained`` tells whether the drive has a
    trained scene, without which actors of other scenes are not shown.
    """
    limits = limits or Limits()
    actors = [obj for obj in sampled.of("ACTOR") if obj.there.any()]
    edited = [obj for obj in actors if not _as_recorded(obj, drive, sampled.clock)]
    ground = undersides(drive)
    for obj in edited:
        label = _label(obj, drive)
        first = int(sampled.clock.frames[int(np.argmax(obj.there))])
        if not label:
            yield Finding(obj.name, first, Text("has no known class, so its motion is not checked"))
        if obj.appearance_scene and not is_trained:
            yield Finding(
                obj.name, first, Text("is of another scene, so it is not shown without a trained scene of this drive")
            )
        yield from _motion(obj, label, sampled.clock)
        yield from _pose(obj, label, drive, sampled.clock)
        yield from _limits(obj, drive, sampled.clock, limits)
        yield from _height(obj, ground, sampled.clock)
        yield from _size(obj, sampled.clock)
    changed = {obj.name for obj in edited}
    for i, a in enumerate(actors):
        for b in actors[i + 1 :]:
            if {a.name, b.name} & changed:
                yield from _overlap(a, b, sampled.clock)
    for obj in sampled.of("EGO"):
        yield from _limits(obj, drive, sampled.clock, limits)
    for obj in sampled.of("CAMERA"):
        yield from _far(obj, drive, sampled.clock)
        yield from _aside(obj, drive, sampled.clock)


def shadow_note(sampled: Sampled, drive: Drive, is_trained: bool) -> str:
    """Return what becomes of the recorded shadows of actors that are not as recorded, as one sentence; "" without any,
    and where a sun moves them. Only a trained scene has ground in actors' boxes."""
    names = [
        obj.name
        for obj in sampled.of("ACTOR")
        if obj.there.any() and not obj.mesh and not _as_recorded(obj, drive, sampled.clock)
    ]
    if not names or (is_trained and sampled.light is not None):
        return ""
    actors = ", ".join(names[:MOST_NAMED]) + (f" + {len(names) - MOST_NAMED}" if len(names) > MOST_NAMED else "")
    if not is_trained:
        return Text("Recorded shadows stay where they were: {actors}", actors=actors)
    return Text("Recorded shadows stay where they were, but for what is under the actor: {actors}", actors=actors)


def _as_recorded(obj: SampledObject, drive: Drive, clock: Clock) -> bool:
    actor = drive.actors.get(obj.uid)
    if actor is None or not obj.is_original or obj.appearance or obj.scaling != Scaling():
        return False
    return not differs(obj.poses, obj.there, actor, drive, clock)


def _label(obj: SampledObject, drive: Drive) -> str:
    return label_of(obj.kind, obj.appearance or obj.uid, obj.appearance_scene, obj.label if obj.mesh else "", drive)


def _motion(obj: SampledObject, label: str, clock: Clock) -> Iterator[Finding]:
    step = np.diff(obj.poses[:, :3, 3], axis=0)
    both = obj.there[1:] & obj.there[:-1]
    speed = np.linalg.norm(step, axis=1) / np.diff(clock.times_s)
    limit = FASTEST_STILL_M_S if motion_of(label) == "still" else FASTEST_M_S[group_of(label)]
    too_fast = both & (speed > limit)
    if too_fast.any():
        at = int(np.argmax(np.where(too_fast, speed, 0)))
        yield Finding(obj.name, int(clock.frames[at]), Text("goes {speed}", speed=kmh(float(speed[at]))))
    if is_limited(label):
        ahead = obj.poses[:-1, :3, 0]
        along = np.abs((step * ahead).sum(1)) / np.maximum(np.linalg.norm(step, axis=1), 1e-9)
        skids = both & (speed > MOVING_M_S) & (np.arccos(np.clip(along, 0, 1)) > SIDEWAYS_RAD)
        if skids.any():
            yield Finding(obj.name, int(clock.frames[int(np.argmax(skids))]), Text("drives sideways"))


def _pose(obj: SampledObject, label: str, drive: Drive, clock: Clock) -> Iterator[Finding]:
    """Yield where an actor that changes its shape as it goes does so at a speed that nobody recorded of it."""
    if motion_of(label) != "deforming" or obj.mesh or obj.appearance_scene:
        return
    track = ObjectTrack(obj.name, obj.kind, obj.appearance or obj.uid, label, obj.poses, obj.there)
    motion = compared(track, drive, clock, Limits())
    if motion.recorded is None or np.isnan(motion.recorded.speed_m_s).all():
        return
    now, least, most = motion.now.speed_m_s, *(f(motion.recorded.speed_m_s) for f in (np.nanmin, np.nanmax))
    beyond = np.nan_to_num(np.maximum(now - SPEED_TOLERANCE * most, least / SPEED_TOLERANCE - now))
    if beyond.max() > SPEED_NOISE_M_S:
        at = int(beyond.argmax())
        speeds = {"speed": kmh(float(now[at])), "least": kmh(float(least)), "most": kmh(float(most))}
        text = Text("goes {speed} and was recorded at {least} to {most}: its pose is extrapolated", **speeds)
        yield Finding(obj.name, int(clock.frames[at]), text)


def _limits(obj: SampledObject, drive: Drive, clock: Clock, limits: Limits) -> Iterator[Finding]:
    """Yield where it exceeds each limit of motion most."""
    label = _label(obj, drive)
    uid = obj.uid if obj.is_original or not obj.appearance else ""  # an inserted actor was recorded nowhere
    motion = compared(ObjectTrack(obj.name, obj.kind, uid, label, obj.poses, obj.there), drive, clock, limits)
    for name, where in motion.exceeded.items():
        if where.any():
            values = getattr(motion.now, name)
            at = int(np.argmax(np.where(where, np.abs(values), -1)))
            yield Finding(obj.name, int(clock.frames[at]), describe(name, float(values[at])))


def _height(obj: SampledObject, ground: FloatArray, clock: Clock) -> Iterator[Finding]:
    """Its underside beside the ground there."""
    if not len(ground):
        return
    under = obj.poses[:, :3, 3] - obj.poses[:, :3, 2] * obj.size_m[2] / 2
    off = under[:, 2] - heights(ground, under)
    wrong = obj.there & (np.abs(np.nan_to_num(off)) > OFF_GROUND_M)
    if wrong.any():
        at = int(np.argmax(wrong))
        height = float(abs(off[at]))
        text = Text(
            "is {height:.1f} m above the ground" if off[at] > 0 else "is {height:.1f} m below the ground", height=height
        )
        yield Finding(obj.name, int(clock.frames[at]), text)


def _size(obj: SampledObject, clock: Clock) -> Iterator[Finding]:
    """Its size beside what was recorded, and a scale that cannot be rendered."""
    frame, (least, most) = int(clock.frames[int(np.argmax(obj.there))]), PLAUSIBLE_SCALE
    if obj.scaling.fault:
        yield Finding(obj.name, frame, WHY[obj.scaling.fault])
    elif not all(least <= factor <= most for factor in obj.scaling.factors):
        sentence, factors = (
            translatable("is scaled by {factors}, beyond {least:g} to {most:g}"),
            scale_text(obj.scaling.factors),
        )
        yield Finding(obj.name, frame, Text(sentence, factors=factors, least=least, most=most))
    shortest, longest = PLAUSIBLE_EXTENT_M
    if obj.mesh and not shortest <= max(obj.size_m) <= longest:
        yield Finding(obj.name, frame, Text("has an extent of {size:.3g} m", size=float(max(obj.size_m))))


def _overlap(a: SampledObject, b: SampledObject, clock: Clock) -> Iterator[Finding]:
    reach = (np.linalg.norm(a.size_m) + np.linalg.norm(b.size_m)) / 2
    near = a.there & b.there & (np.linalg.norm(a.poses[:, :3, 3] - b.poses[:, :3, 3], axis=1) < reach)
    for at in np.flatnonzero(near):
        if boxes_overlap(a.poses[at], np.array(a.size_m), b.poses[at], np.array(b.size_m)):
            yield Finding(a.name, int(clock.frames[at]), Text("overlaps {other}", other=b.name))
            return


def boxes_overlap(pose_a: FloatArray, size_a: FloatArray, pose_b: FloatArray, size_b: FloatArray) -> bool:
    """Whether two boxes, made smaller by `OVERLAP_M`, have a point in common: no face or pair of edges parts them (the
    separating axes of Gottschalk, Lin and Manocha, "OBBTree", 1996)."""
    corners = [
        box_corners(pose, np.maximum(size - OVERLAP_M, 1e-3)) for pose, size in ((pose_a, size_a), (pose_b, size_b))
    ]
    faces = np.concatenate([pose_a[:3, :3].T, pose_b[:3, :3].T])
    edges = np.cross(faces[:3, None], faces[None, 3:]).reshape(-1, 3)
    axes = np.concatenate([faces, edges[np.linalg.norm(edges, axis=1) > 1e-6]])
    low, high = zip(*(((c @ axes.T).min(0), (c @ axes.T).max(0)) for c in corners), strict=True)
    return bool(((low[0] <= high[1]) & (low[1] <= high[0])).all())


def _far(obj: SampledObject, drive: Drive, clock: Clock) -> Iterator[Finding]:
    places = [camera.world_from_camera.positions for camera in drive.cameras.values()]
    if not places:
        return
    away = np.linalg.norm(obj.poses[:, None, :3, 3] - np.concatenate(places)[None], axis=-1).min(1)
    if away.max() > FAR_VIEW_M:
        at = int(away.argmax())
        yield Finding(
            obj.name,
            int(clock.frames[at]),
            Text("looks from {length:.1f} m beside anything recorded", length=float(away[at])),
        )


def _aside(obj: SampledObject, drive: Drive, clock: Clock) -> Iterator[Finding]:
    """Whether a camera looks where none was looking during the drive."""
    unseen = np.array([unseen_share(obj, drive, frame) for frame in range(len(clock.frames))])
    if len(unseen) and unseen.max() > ASIDE_SHARE:
        at = int(unseen.argmax())
        text = Text("looks {share:.0%} beside all that was recorded", share=float(unseen[at]))
        yield Finding(obj.name, int(clock.frames[at]), text)


def unseen_share(obj: SampledObject, drive: Drive, frame: int) -> float:
    """Return which share of a camera's directions, sideways, no camera of the drive ever looked into."""
    if obj.camera is None or not drive.cameras:
        return 0.0
    half = np.radians(degrees_across(obj.camera)) / 2
    ahead = -obj.poses[frame, :3, 2]  # a Blender camera looks along -z
    headings = np.arctan2(ahead[1], ahead[0]) + np.linspace(-half, half, 16)
    seen = np.zeros(len(headings), bool)
    for camera in drive.cameras.values():
        reach = np.radians(degrees_across(camera.model)) / 2
        poses = camera.world_from_camera.at(camera.world_from_camera.times_s)
        axes = np.arctan2(poses[:, 1, 2], poses[:, 0, 2])
        apart = np.abs((headings[:, None] - axes + np.pi) % (2 * np.pi) - np.pi)
        seen |= (apart <= reach).any(1)
    return float((~seen).mean())


def place_of(finding: Finding, sampled: Sampled) -> tuple[float, ...]:
    """Return where in the world the object of a finding is at its frame, in metres."""
    obj = next(obj for obj in sampled.objects if obj.name == finding.name)
    at = int(np.searchsorted(sampled.clock.frames, finding.frame))
    return tuple(obj.poses[at, :3, 3].tolist())


AROUND_M = 3.0
LEAST_RETURNS = 20
LOW_PERCENT = 20.0
"""Of the returns around a place: lower ones are noise, higher ones stand on the ground."""
BESIDE_M = 0.1
"""Distance by which an actor's returns may lie outside its box, metres."""
NEAR_M = 40.0


def ground_height(source: DriveSource, place: FloatArray, frame: int) -> float | None:
    """The ground's z under a place (3,), None where nothing tells."""
    drive, log = source.drive, source.log
    if log is not None:
        for name, lidar in drive.lidars.items():
            frames = log.sweep_frames(name) if lidar.model.beams else ()
            if not frames:
                continue
            nearest = min(frames, key=lambda f: abs(f - frame))
            points = log.sweep(name, nearest).points
            around = points[np.linalg.norm(points[:, :2] - place[:2], axis=1) < AROUND_M]
            around = around[np.abs(around[:, 2] - place[2]) < AROUND_M]
            around = around[~on_actors(drive, around, nearest)]
            if len(around) >= LEAST_RETURNS:
                return float(np.percentile(around[:, 2], LOW_PERCENT))
    height = heights(undersides(drive), place[None])[0]
    return None if np.isnan(height) else float(height)


def on_actors(drive: Drive, points: FloatArray, frame: int) -> BoolArray:
    """Return which points (N, 3) lie on an actor at a frame of the recorded drive: in its box, which is
    drawn generously."""
    mask = np.zeros(len(points), bool)
    time_s = drive.time_s[frame]
    for actor in drive.actors.values():
        start, end = drive.window(actor)
        if start <= time_s <= end:
            inside = transform_points(invert_pose(actor.world_from_actor.at(time_s)), points)
            mask |= (np.abs(inside) <= actor.size_m / 2 + BESIDE_M).all(1)
    return mask


def undersides(drive: Drive) -> FloatArray:
    """Places (M, 3) on the ground, under recorded actors."""
    clock = Clock.of(drive)
    places = [np.zeros((0, 3))]
    for actor in drive.actors.values():
        poses = recorded_poses(actor, clock)[recorded_there(actor, drive, clock)]
        places.append(poses[:, :3, 3] - poses[:, :3, 2] * actor.size_m[2] / 2)
    return np.concatenate(places)


def heights(ground: FloatArray, places: FloatArray) -> FloatArray:
    """The ground's z (N,) under places (N, 3) from places (M, 3) on it, the nearest counting most; NaN
    where none is near."""
    away = np.linalg.norm(ground[None, :, :2] - places[:, None, :2], axis=-1)
    weight = np.where(away < NEAR_M, 1 / (1.0 + away) ** 2, 0.0)
    total = weight.sum(1)
    return np.where(total > 0, (weight * ground[:, 2]).sum(1) / np.maximum(total, 1e-12), np.nan)
