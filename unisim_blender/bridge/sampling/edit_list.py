"""The edits list of each scene, read in steps: what did not change since the last reading is not read again.

`EditListReading.stale` says that the scene may have changed since. Whoever shows the list shows that, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import bpy

from ...core.errors import UnisimError
from ...core.world.drive import Drive
from ...editing.edits.lines import EditLine
from ...editing.reading.scenario import BY_ID, GROUP_OF, group_lines
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import Sampled, SampledObject
from ...editing.texts import unpacked
from ..objects.imported import KINDS_OF_DRIVE, imported_objects, skipped_sensors, source_of
from ..objects.lamps import lamp_settings
from .adjacent_frames import moved_by_keys
from .from_keys import Sampler, evaluated
from .stepping import refuse_stretching, shown_names, static_items

GroupKey = tuple[str, str]
"""Group and id of what is read together."""


@dataclass
class EditListReading:
    """A scene's edits as they were read last. ``problem`` says why they could not be.

    ``stale``: whether the scene may have changed since; ``moved``: whether something may have moved; ``busy``:
    whether it is being
    read.
    """

    lines: tuple[EditLine, ...] = ()
    problem: str = ""
    stale: bool = True
    moved: bool = True
    busy: bool = False
    known: dict[GroupKey, tuple[object, tuple[EditLine, ...]]] = field(default_factory=dict)

    def mark(self, moved: bool = True) -> None:
        """Note that the scene may have changed."""
        self.stale = True
        self.moved |= moved

    def fail(self, problem: str) -> None:
        """Note why the edits could not be read."""
        self.lines, self.problem, self.stale, self.busy = (), problem, False, False

    @property
    def fresh(self) -> bool:
        """Whether the lines are true of the scene as it is."""
        return not self.stale and not self.busy

    @property
    def active(self) -> tuple[EditLine, ...]:
        """The edits that count."""
        return tuple(line for line in self.lines if line.muted < 0 and line.part != "PROBLEM")


_beside: list[bool] = []
"""Holds True where a scene beside was made since `consume_beside_flag` was called."""


def consume_beside_flag() -> bool:
    """Return whether a scene beside was made since the last call: Blender reports that as a change."""
    was_set = bool(_beside)
    _beside.clear()
    return was_set


_readings: dict[str, EditListReading] = {}


def reading_of(scene: bpy.types.Scene) -> EditListReading:
    """Return what is known of a scene's edits."""
    return _readings.setdefault(scene.name, EditListReading())


def mark_all() -> None:
    """Note that every scene may have changed."""
    for name in [name for name in _readings if name not in bpy.data.scenes]:
        del _readings[name]
    for reading in _readings.values():
        reading.mark()


def forget() -> None:
    """Forget all that was read."""
    _readings.clear()


def read_now(scene: bpy.types.Scene) -> tuple[EditLine, ...]:
    """Read a scene's edits at once and return them. Raises `UnisimError` where they cannot be read."""
    reading_of(scene).mark()
    for _ in read_steps(scene):
        pass
    reading = reading_of(scene)
    if reading.problem:
        raise UnisimError(reading.problem)
    return reading.lines


def read_steps(scene: bpy.types.Scene) -> Iterator[None]:
    """Read a scene's edits, a step of some milliseconds at a time. To be begun anew where the scene changes
    meanwhile."""
    reading = reading_of(scene)
    reading.stale, reading.busy, moved = False, True, reading.moved
    try:
        source = source_of(scene)
        clock = Clock.of(source.drive)
        refuse_stretching(scene)
    except (UnisimError, OSError) as fault:
        reading.fail(str(fault))
        return
    sampler = Sampler(scene, clock, shown_names(scene.view_layers[0].layer_collection))
    known: dict[GroupKey, tuple[object, tuple[EditLine, ...]]] = {}
    marked = tuple((item.name, item.model) for item in scene.unisim.static_items)
    lines, lamps = list[EditLine](), lamp_settings(scene)
    for key, group in _groups(scene, source.drive).items():
        signature = (
            tuple(sampler.signature(obj) for obj in group),
            clock.frames.tobytes(),
            str(source.scene_path),
            marked if key[0] == "STATIC" else (),
            tuple(lamp for lamp in lamps if lamp.actor == key[1]),
        )
        before = reading.known.get(key)
        free = [obj for obj in group if not moved_by_keys(obj)]
        if before is not None and before[0] == signature and not (free and moved):
            known[key] = before
        else:
            sampled: list[SampledObject] = []
            yield from _sampled(sampler, group, free, sampled)
            known[key] = signature, tuple(_lines(key, sampled, source.drive, clock, scene))
        lines += known[key][1]
        yield
    lines += muted_lines(scene)
    reading.known, reading.moved, reading.busy = known, False, False
    reading.problem, reading.lines = (
        "",
        tuple(sorted(lines, key=lambda line: (line.part != "PROBLEM", line.who, line.part))),
    )


def muted_lines(scene: bpy.types.Scene) -> list[EditLine]:
    """Return the lines of the edits that are muted, as they were read when they were muted."""
    return [
        EditLine(
            item.kind, item.uid, item.part, unpacked(item.what_parts, item.what), item.name, item.thing, item.start_s,
            item.end_s,
            tuple(range(item.first, item.last + 1)), None, number,
        )
        for number, item in enumerate(scene.unisim_edits.muted)
    ]  # fmt: skip


def _groups(scene: bpy.types.Scene, drive: Drive) -> dict[GroupKey, list[bpy.types.Object]]:
    """Return what has to be read together: each actor with its copies, the rig, the static items."""
    groups: dict[GroupKey, list[bpy.types.Object]] = {("RIG", ""): []}
    groups |= {("ACTOR", uid): [] for uid in sorted(drive.actors)}
    for obj in imported_objects(scene, *KINDS_OF_DRIVE):
        group = GROUP_OF[obj.unisim.kind]
        groups.setdefault((group, obj.unisim.uid if group in BY_ID else ""), []).append(obj)
    if len(scene.unisim.static_items):
        groups.setdefault(("STATIC", ""), [])
    return groups


def _sampled(
    sampler: Sampler, group: list[bpy.types.Object], free: list[bpy.types.Object], sampled: list[SampledObject]
) -> Iterator[None]:
    """Sample a group into ``sampled``, with rests."""
    beside = yield from evaluated(sampler.clock.frames, free, lambda: _beside.append(True))
    for obj in group:
        sampled.append(sampler.sample(obj, *beside.get(obj.name, ())))
        if obj.unisim.kind != "ACTOR":  # a sensor takes milliseconds, an actor none
            yield


def _lines(
    key: GroupKey, sampled: list[SampledObject], drive: Drive, clock: Clock, scene: bpy.types.Scene
) -> Iterator[EditLine]:
    """Yield the lines of a group."""
    read = Sampled(
        scene.name, clock, tuple(sampled), static_items(scene), skipped_sensors(scene), lamps=lamp_settings(scene)
    )
    return group_lines(*key, read, drive)


def renamed(before: str, after: str) -> None:
    """Keep what was read of a scene that got another name."""
    if before in _readings:
        _readings[after] = replace(_readings.pop(before), stale=True)
