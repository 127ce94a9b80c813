"""A line of the edits list: what of a sampled scene is edited, in words, and from when to when; the parts of objects
that lines tell of; and the words for displacements, times and trajectories.

Readers make the lines of the same edits that a scenario is made of.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ...core.errors import ScenarioError
from ...core.geometry import BoolArray, FloatArray, Trajectory, invert_pose
from ..sampled.clock import Clock
from ..sampled.scene import SAME_M, SampledObject, same
from ..texts import LOWER, UPPER, Text, cased, series, translatable

OWN_OBJECT, PLACE = "own_object", "place"
"""Carriers of an edit: an object that would not be there without it; where an object of the drive is, and
whether it is there."""


@dataclass(frozen=True)
class EditPart:
    """A part by its name, which files keep. ``icons`` are those of lines that begin with a word.

    ``carrier`` is the module of `bridge/changes/carriers` that mutes, unmutes and takes back its edits; "" where
    nothing can be. ``is_absence``: whether the object is gone, so that none of its other edits counts beside.
    """

    name: str
    icon: str
    carrier: str = PLACE
    is_absence: bool = False
    icons: Mapping[str, str] = field(default_factory=dict)

    def icon_of(self, words: str) -> str:
        """Name of the icon of a line."""
        return next((icon for word, icon in self.icons.items() if words.startswith(word)), self.icon)


PARTS = {
    part.name: part
    for part in (
        EditPart("REMOVE", "TRASH", is_absence=True),
        EditPart("APPEARANCE", "SHADING_TEXTURE", "appearance"),
        EditPart("MOVE", "ORIENTATION_GLOBAL", icons={"Retimed": "TIME"}),
        EditPart("COPY", "DUPLICATE", OWN_OBJECT),
        EditPart("INSERT", "ADD", OWN_OBJECT),
        EditPart("MESH", "MESH_MONKEY", OWN_OBJECT),
        EditPart("SCALE", "FULLSCREEN_ENTER", "scale"),
        EditPart("LAMP", "LIGHT", ""),
        EditPart("BODY", "AUTO", OWN_OBJECT),
        EditPart("SENSOR", "CAMERA_DATA"),
        EditPart("EGO", "AUTO"),
        EditPart("PROBLEM", "ERROR", ""),
    )
}
"""The parts by their names. A reader may add one of its own."""


@dataclass(frozen=True)
class EditLine:
    """One edit. ``who`` is the object's name as the scenario has it, ``object_name`` as Blender has it, "" where
    it is not there.

    ``frames`` are those at which the edit shows, ``start_s`` and ``end_s`` the times of the first and the last.
    ``edit`` is what the scenario holds. ``muted`` is the number of the muted edit, -1 where it is not muted.
    """

    kind: str
    uid: str
    part: str
    what: str
    who: str
    object_name: str
    start_s: float
    end_s: float
    frames: tuple[int, ...]
    edit: object = None
    muted: int = -1

    @property
    def icon(self) -> str:
        """Name of the icon."""
        return PARTS[self.part].icon_of(self.what)

    @property
    def is_own_object(self) -> bool:
        """Whether the edit is an object of its own: without the edit there is none."""
        return PARTS[self.part].carrier == OWN_OBJECT

    @property
    def key(self) -> tuple[str, str, str]:
        """Key that distinguishes the edit from the others of a scene, and is the same in every variant."""
        return self.kind, self.who if self.is_own_object else self.uid, self.part


def line_of(
    kind: str, uid: str, part: str, what: str, named: tuple[str, str], shows: BoolArray, clock: Clock, edit: object
) -> EditLine:
    """Return the line of an edit that shows at some of the clock's frames (N,); at all, where at none. ``named`` are
    the names of its object in the scenario and in Blender."""
    at = np.flatnonzero(shows) if shows.any() else np.arange(len(clock.frames))
    frames = tuple(int(frame) for frame in clock.frames[at])
    return EditLine(
        kind, uid, part, what, *named, float(clock.times_s[at[0]]), float(clock.times_s[at[-1]]), frames, edit
    )


def problem_line(kind: str, uid: str, fault: ScenarioError, objects: Iterable[SampledObject]) -> EditLine:
    """Return the line of what keeps a scene from being read."""
    obj = next((obj for obj in objects if f'"{obj.name}"' in str(fault)), None)
    text, title, name = str(fault).split(": ", 1)[-1], "", ""
    if obj is not None:
        title, name = obj.title, obj.name
    return EditLine(kind, uid, "PROBLEM", text[0].upper() + text[1:], title, name, 0.0, 0.0, ())


def nearest_frame(frames: tuple[int, ...], now: int) -> int:
    """Return the frame of some that is nearest to ``now``."""
    return min(frames, key=lambda frame: (abs(frame - now), frame), default=now)


def conflicting(line: EditLine, lines: Iterable[EditLine]) -> list[EditLine]:
    """Return the edits that count and cannot stand beside a muted one: an actor has one trajectory, one appearance,
    or is gone."""
    if line.is_own_object:
        return []
    part = PARTS[line.part]
    own = [
        other
        for other in lines
        if other.muted < 0
        and not other.is_own_object
        and PARTS[other.part].carrier
        and (other.kind, other.uid) == (line.kind, line.uid)
    ]
    if part.is_absence:
        return own
    # what is carried by the same, and an absence
    return [other for other in own if PARTS[other.part].carrier == part.carrier or PARTS[other.part].is_absence]


RETIMED_FRAMES = 0.02
"""Trajectories whose first or last key is this far from the recorded one are retimed."""
NEAR_M = 0.1
"""A retimed object is no further than this from the recorded path."""
SAME_S = 0.05
"""Delays that differ by less count as one delay."""
SLOW_M_S = 0.5
"""Below this speed a place on the path does not tell the time."""
DIRECTIONS = (
    (translatable("{length} forward"), translatable("{length} back")),
    (translatable("{length} left"), translatable("{length} right")),
    (translatable("{length} up"), translatable("{length} down")),
)
"""Along an object's axes, and against them."""
MOSTLY = 0.95
"""Share of a displacement along one axis from which on that direction is told."""
SMALL = 0.05
"""A share of the largest component of a displacement below which another is not told."""
FINE = 10
"""Samples of the recorded path for each frame."""
BEYOND_S = 3.0
"""Time by which the recorded path is extended beyond its ends, in seconds."""


def metres(value: float) -> str:
    """Return a distance with as many digits as it needs: "3.0 m", "1.25 m", "0.04 m"."""
    return f"{decimals(value)} m" if value >= 0.005 or value < 5e-5 else f"{1000 * value:.1f} mm"


def decimals(value: float) -> str:
    """Return a number with one or two decimals."""
    text = f"{value:.2f}"
    return text[:-1] if text.endswith("0") else text


def moved_words(apart: FloatArray) -> str:
    """Return what a displacement (4, 4) in an object's own axes (forward, left, up) does: "3.0 m left, turned 10°
    right"."""
    largest = float(np.abs(apart[:3, 3]).max())
    words: list[str] = []
    for value, (more, less) in zip(apart[:3, 3], DIRECTIONS, strict=True):
        if abs(value) > max(SAME_M, SMALL * largest):
            words.append(Text(more if value > 0 else less, length=metres(abs(float(value)))))
    return series([*words, *turned_words(apart[:3, :3])])


def degrees(value: float) -> str:
    """Return an angle with as many digits as it needs: "20°", "0.4°"."""
    return f"{value:.0f}°" if value >= 9.95 else f"{value:.1f}°"


def turned_words(rotation: FloatArray) -> list[str]:
    """Return what a rotation (3, 3) does, in no more than one phrase."""
    yaw = np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0]))
    whole = np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))
    if whole < 0.05:
        return []
    if abs(whole - abs(yaw)) < 0.05 + 0.02 * whole:
        return [Text("turned {angle} left" if yaw > 0 else "turned {angle} right", angle=degrees(abs(yaw)))]
    return [Text("turned by {angle}", angle=degrees(whole))]


def displaced_words(apart: FloatArray) -> str:
    """Return what displacements (N, 4, 4) do, one for each frame: the same phrase for all, or how large they get."""
    if len(apart) == 0 or same(apart, np.eye(4)).all():
        return ""
    spread = np.ptp(apart[:, :3, 3], axis=0).max()
    turns = np.abs(apart[:, :3, :3] - apart[:1, :3, :3]).max()
    if spread <= 4 * SAME_M and turns < 1e-4:
        by = moved_words(apart[len(apart) // 2])
        return cased(by, UPPER) if by.startswith("turned") else moved(by)
    far = apart[np.linalg.norm(apart[:, :3, 3], axis=1).argmax(), :3, 3]
    axis, length = int(np.abs(far).argmax()), float(np.linalg.norm(far))
    if length < SAME_M:
        return Text("Turned")
    away = metres(length)
    if abs(far[axis]) > MOSTLY * length:
        away = Text(DIRECTIONS[axis][int(far[axis] < 0)], length=away)
    return moved(Text("by up to {away}", away=away))


def moved(by: str) -> Text:
    """Return that an object is moved, and how far."""
    return Text("Moved {by}", by=by)


def unmoved(phrase: str) -> str:
    """Return how far a phrase of `moved` says that an object is moved; another phrase as it is."""
    by = phrase.values.get("by") if isinstance(phrase, Text) else None
    return by if isinstance(by, str) else phrase


def retimed_words(times_s: FloatArray, places: FloatArray, recorded: Trajectory) -> str:
    """Return how much later or earlier an object at ``places`` (N, 3) is on the recorded path; "" where it is not on
    the path."""
    first, last = float(recorded.times_s[0]) - BEYOND_S, float(recorded.times_s[-1]) + BEYOND_S
    step = max((last - first) / 4000, float(np.median(np.diff(times_s))) / FINE if len(times_s) > 1 else 0.01)
    then = np.arange(first, last, step)
    path = recorded.at(then)[:, :3, 3]
    speed = np.linalg.norm(np.gradient(path, then, axis=0), axis=1)
    away = np.linalg.norm(places[:, None] - path[None], axis=-1)
    nearest = away.argmin(1)
    if away.min(1).max() > NEAR_M:
        return ""
    delays = (times_s - then[nearest])[speed[nearest] > SLOW_M_S]
    if len(delays) == 0:
        return ""
    low, high = float(delays.min()), float(delays.max())
    if high - low < SAME_S:
        middle = float(np.median(delays))
        if abs(middle) < SAME_S / 4:
            return ""
        return Text("Retimed: {time} later" if middle > 0 else "Retimed: {time} earlier", time=seconds(abs(middle)))
    if low > -SAME_S:
        return Text("Retimed: up to {time} later", time=seconds(high))
    if high < SAME_S:
        return Text("Retimed: up to {time} earlier", time=seconds(-low))
    return Text("Retimed: {before} earlier to {after} later", before=seconds(-low), after=seconds(high))


def seconds(value: float) -> str:
    """Return a duration: "0.6 s", "0.25 s"."""
    return f"{decimals(value)} s"


def trajectory_words(
    clock: Clock, poses: FloatArray, base: FloatArray, recorded: Trajectory | None, retimed: bool
) -> str:
    """Return how a trajectory's poses (N, 4, 4) differ from the recorded ones, ``base`` (N, 4, 4); "" where they do
    not.

    ``retimed``: whether its keys lie at other times than the recorded ones.
    """
    if len(poses) == 0 or same(poses, base).all():
        return ""
    if retimed and recorded is not None and (words := retimed_words(clock.times_s, poses[:, :3, 3], recorded)):
        return words
    apart = (poses - base)[:, :3, 3]
    if np.ptp(apart, axis=0).max() <= 4 * SAME_M and np.abs((poses - base)[:, :3, :3]).max() < 1e-4:
        return displaced_words((invert_pose(base) @ poses)[:1])
    words = displaced_words(invert_pose(base) @ poses)
    if same(poses, poses[:1]).all() and not same(base, base[:1]).all():
        return Text("Stands still")
    if "up to" not in words:
        return words
    return Text("New trajectory, up to {length} away", length=metres(float(np.linalg.norm(apart, axis=1).max())))


def presence_words(clock: Clock, there: BoolArray) -> str:
    """Return from when to when an object is there."""
    at = clock.times_s[there]
    return Text("Present from {start:.1f} to {end:.1f} s", start=float(at[0]), end=float(at[-1]))


def joined(parts: Iterable[str]) -> str:
    """Return phrases as one: the first as it is, the others beginning small."""
    phrases = [part for part in parts if part]
    return series([*phrases[:1], *(cased(part, LOWER) for part in phrases[1:])], "; ") if phrases else ""


def turned(poses: FloatArray, turn: FloatArray) -> FloatArray:
    """Return poses (N, 4, 4) turned on the spot by rotations (N, 3, 3) or one of them."""
    new = poses.copy()
    new[:, :3, :3] = turn @ poses[:, :3, :3]
    return new


def is_retimed(obj: SampledObject, recorded: Trajectory, clock: Clock) -> bool:
    """Return whether the keys of an object's trajectory lie at other times than the recorded ones."""
    keys = clock.frame(recorded.times_s[[0, -1]])
    return obj.span is not None and bool(np.abs(np.array(obj.span) - keys).max() > RETIMED_FRAMES)
