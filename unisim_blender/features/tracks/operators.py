"""Boxes found, drawn, accepted, merged, split, classed, stepped through where they are doubtful, and saved."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.props import EnumProperty

from ...bridge.importing.tracks import (
    exchange_actors,
    hide_actors,
    new_uid,
    put_track,
    saved_tracks,
    set_track,
    take_tracks,
    track_of,
    tracks_in,
)
from ...bridge.objects.imported import imported_objects, source_of
from ...bridge.objects.sensors import camera_model_of
from ...bridge.objects.trajectories import keyed_pose, remove
from ...bridge.sampling.stepping import frame_of
from ...bridge.window import Need, areas, choose, chosen, drive, object_mode, redraw
from ...core.errors import UnisimError
from ...core.geometry import Trajectory, make_pose, quaternion_from_yaw
from ...core.tracks.box_file import (
    Track,
    default_path,
    halves,
    is_box_file,
    joined,
    read_boxes,
    track_to_json,
    unused_uid,
    write_boxes,
)
from ...core.tracks.doubtful import DoubtfulPlace, doubtful_places
from ...core.tracks.shape import USUAL_M
from ...core.world.drive import Actor, Appearance
from ...editing.motion.plausibility import ground_height
from ...editing.sampled.clock import Clock
from ...editing.sampled.source import DriveSource, open_source
from ...editing.texts import Text, translatable
from ...preferences import interpreter
from ...process.background import launch
from ...process.tasks import ShareTask
from ...translations import localized, message
from ..operator_bases import AtOnce, EditsObjects, Needing, in_thread, nothing_runs, reporting
from .following import selected_boxes
from .properties import show_certain

LABELS = tuple((name, name, "") for name in USUAL_M)
ACCEPTED = 1.0
PLACE_TEXTS = {
    "jump": translatable("jumps by {value:.1f} m"),
    "gap": translatable("is not seen for {value:.1f} s"),
    "overlap": translatable("shares {value:.0%} of its area with another box"),
    "speed": translatable("drives {value:.0f} m/s"),
    "turn": translatable("turns by {value:.1f} rad/s"),
    "sideways": translatable("moves {value:.1f} rad off its heading"),
    "size": translatable("has an edge of {value:.1f} m"),
    "uncertain": translatable("is certain by {value:.0%} only"),
}


def boxes_there(context: bpy.types.Context) -> Need:
    """There are boxes to correct."""
    return tracks_in(context.scene), "Find actors, edit the boxes of the log, or draw a box first"


def begin(scene: bpy.types.Scene, tracks: list[Track], source: DriveSource) -> list[bpy.types.Object]:
    """Put tracks into a scene as boxes; the actors that are there are hidden meanwhile."""
    taken = {obj.unisim.uid for obj in tracks_in(scene)}
    boxes = []
    for track in tracks:
        uid = unused_uid(track.actor.uid, taken)
        boxes.append(put_track(scene, replace(track, actor=replace(track.actor, uid=uid)), source.drive))
        taken.add(uid)
    hide_actors(scene, True)
    show_certain(scene.unisim_tracks, bpy.context)
    return boxes


class FindTask(ShareTask):
    """Actors found in the sweeps of a log."""

    title = translatable("Finding actors")

    def finish(self) -> None:
        """Put the boxes that were found into the scene that asked for them."""
        scene = bpy.data.scenes.get(self.scene)
        if self.code != 0 or scene is None:
            return
        tracks = list(read_boxes(self.folder / FOUND).tracks)
        begin(scene, tracks, source_of(scene))
        if not bpy.app.background:
            bpy.ops.ed.undo_push(message="Find Actors")
        redraw("VIEW_3D")


FOUND = "found.boxes.json"


class UNISIM_OT_find_actors(Needing, bpy.types.Operator):
    """Find what moves and what stands as vehicles do in the sweeps of the log, in the background"""

    bl_label = "Find Actors"
    bl_options = {"REGISTER"}
    needs = (object_mode, drive, nothing_runs)

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        source = source_of(context.scene)
        if source.log is None:
            raise UnisimError(message("{log}: is not at hand, and actors are found in its sweeps", log=source.log_path))
        folder = Path(tempfile.mkdtemp(prefix="unisim-found-"))
        options = ["--certainty", "0", "--poses", "log", "--json", "--out", str(folder / FOUND)]
        launch(FindTask(["track", str(source.log_path), *options], folder, 100.0, interpreter()))
        return {"FINISHED"}


class UNISIM_OT_edit_boxes(EditsObjects, bpy.types.Operator):
    """Correct the boxes that the log has: its actors are hidden until the boxes are saved"""

    bl_label = "Edit the Log's Boxes"
    needs = (object_mode, drive)

    def edit(self, context: bpy.types.Context) -> None:
        scene = context.scene
        source = source_of(scene)
        if is_box_file(source.log_path):
            tracks = list(read_boxes(source.log_path).tracks)
        else:
            tracks = [Track(actor, source="log") for _, actor in sorted(source.drive.actors.items())]
        there = {obj.unisim.uid for obj in tracks_in(scene)}
        begin(scene, [track for track in tracks if track.actor.uid not in there], source)


class UNISIM_OT_draw_box(EditsObjects, bpy.types.Operator):
    """Add a box of a class at the 3D cursor, along the vehicle's heading; move and turn it, then Track This"""

    bl_label = "Draw Box"
    needs = (object_mode, drive)

    label: EnumProperty(name="Class", description="Class of the actor", items=LABELS, default="Car")

    def edit(self, context: bpy.types.Context) -> None:
        scene = context.scene
        source = source_of(scene)
        size, place = np.array(USUAL_M[self.label]), np.array(scene.cursor.location, float)
        ego = next(imported_objects(scene, "EGO"), None)
        heading = 0.0
        if ego is not None:
            pose = keyed_pose(ego, frame_of(scene))
            heading = float(np.arctan2(pose[1, 0], pose[0, 0]))
        ground_m = ground_height(source, place, scene.frame_current)
        place[2] = size[2] / 2 + (place[2] if ground_m is None else ground_m)
        uid = new_uid(scene, source.drive)
        path = Trajectory.from_poses(np.zeros(1), make_pose(place, quaternion_from_yaw(heading))[None])
        actor = Actor(uid, self.label, size, path, -np.inf, np.inf, False, Appearance(uid))
        (obj,) = begin(scene, [Track(actor, ACCEPTED, "person")], source)
        choose(context, obj)


class UNISIM_OT_accept_boxes(EditsObjects, bpy.types.Operator):
    """Take the selected boxes for certain: they are saved whatever the threshold is"""

    bl_label = "Accept"
    needs = (object_mode, selected_boxes)

    def edit(self, context: bpy.types.Context) -> None:
        for obj in chosen(context, "TRACK"):
            obj.unisim_track.certainty = ACCEPTED


class UNISIM_OT_delete_boxes(EditsObjects, bpy.types.Operator):
    """Delete the selected boxes"""

    bl_label = "Delete Boxes"
    needs = (object_mode, selected_boxes)

    def edit(self, context: bpy.types.Context) -> None:
        for obj in chosen(context, "TRACK"):
            remove(obj)


class UNISIM_OT_class_boxes(EditsObjects, bpy.types.Operator):
    """Set the class of the selected boxes; their sizes stay"""

    bl_label = "Set Class"
    needs = (object_mode, selected_boxes)

    label: EnumProperty(name="Class", description="Class of the actor", items=LABELS, default="Car")

    def edit(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        drive, boxes = source_of(context.scene).drive, chosen(context, "TRACK")
        for obj in boxes:
            track = track_of(obj, Clock.of(drive))
            set_track(obj, replace(track, actor=replace(track.actor, label=self.label)), drive)
        return boxes


MOST_NEAR = 12
_near: list[tuple[str, str, str]] = []
"""Items of the menu, which Blender does not keep."""


def apart(a: Actor, b: Actor) -> float:
    """Return how far two actors are apart, metres: where they begin, or where one ends and the other begins, to which each
    second between these adds 5 m."""
    places = {actor.uid: actor.world_from_actor.positions for actor in (a, b)}
    distances = [float(np.linalg.norm(places[a.uid][0] - places[b.uid][0]))]
    for first, then in ((a, b), (b, a)):
        if np.isfinite(later_s := then.start_s - first.end_s):
            away = float(np.linalg.norm(places[then.uid][0] - places[first.uid][-1]))
            distances.append(away + 5 * abs(later_s))
    return min(distances)


def near_boxes(self: Any, context: bpy.types.Context | None) -> list[tuple[str, str, str]]:
    """Return the boxes whose ends are nearest to those of the active one, nearest first: one that goes as another comes is
    not there at one frame with it, and cannot be selected."""
    obj = None if context is None else context.active_object
    if context is None or obj is None or obj.unisim.kind != "TRACK":
        return [("", "", "")]
    clock, others = Clock.of(source_of(context.scene).drive), [o for o in tracks_in(context.scene) if o is not obj]
    own = track_of(obj, clock).actor
    items = sorted((apart(own, track_of(other, clock).actor), other.unisim.uid, other.name) for other in others)
    _near[:] = [(uid, name, f"{away:.0f} m") for away, uid, name in items[:MOST_NEAR]]
    return _near or [("", "", "")]


class UNISIM_OT_merge_boxes(EditsObjects, bpy.types.Operator):
    """Make one box of the active one and another, with class and size of the active one, which counts where both are there"""

    bl_label = "Merge With"
    needs = (object_mode, selected_boxes)

    other: EnumProperty(name="Other", description="Box that becomes a part of the active one", items=near_boxes)

    def edit(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        scene, active = context.scene, context.active_object
        clock = Clock.of(source_of(scene).drive)
        others = [obj for obj in tracks_in(scene) if obj.unisim.uid == self.other and obj is not active]
        if active is None or active.unisim.kind != "TRACK" or not others:
            raise UnisimError(message("there is no other box to merge with"))
        whole = joined(track_of(active, clock), [track_of(obj, clock) for obj in others])
        for obj in others:
            remove(obj)
        set_track(active, whole, source_of(scene).drive)
        return [active]


class UNISIM_OT_split_boxes(EditsObjects, bpy.types.Operator):
    """Split the selected boxes at this frame, from which on another box has another id"""

    bl_label = "Split Here"
    needs = (object_mode, selected_boxes)

    def edit(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        scene, made = context.scene, list[bpy.types.Object]()
        source = source_of(scene)
        clock = Clock.of(source.drive)
        time_s = float(clock.time_s(np.array(float(frame_of(scene)))))
        for obj in chosen(context, "TRACK"):
            track = track_of(obj, clock)
            start, end = source.drive.window(track.actor)
            if not start + 1e-3 < time_s < end:
                raise UnisimError(message("{name}: is not there before and after this frame", name=obj.name))
            first, second = halves(track, time_s, new_uid(scene, source.drive, track.actor.uid))
            set_track(obj, first, source.drive)
            made += [obj, put_track(scene, second, source.drive)]
        choose(context, *made)
        return made


def places_of(scene: bpy.types.Scene) -> tuple[DoubtfulPlace, ...]:
    """Return the doubtful places of the boxes that are shown."""
    clock, least = Clock.of(source_of(scene).drive), scene.unisim_tracks.certainty
    shown = [track_of(obj, clock) for obj in tracks_in(scene) if obj.unisim_track.certainty >= least]
    return doubtful_places(shown, clock.times_s)


class UNISIM_OT_next_doubtful(EditsObjects, bpy.types.Operator):
    """Go to the next doubtful place of a box: a jump, a gap, two boxes in one, an implausible speed, turn or size"""

    bl_label = "Next Doubtful Place"
    needs = (object_mode, boxes_there)

    back: bpy.props.BoolProperty(name="Back", description="Go to the one before", options={"SKIP_SAVE"})

    def edit(self, context: bpy.types.Context) -> None:
        scene = context.scene
        places = places_of(scene)
        if not places:
            scene.unisim_tracks.place = ""
            self.report({"INFO"}, message("No place is doubtful"))
            return
        keys = [[place.uid, round(place.time_s, 3), place.kind] for place in places]
        shown = json.loads(scene.unisim_tracks.place or "null")
        step = -1 if self.back else 1
        at = (keys.index(shown["key"]) + step) % len(keys) if shown and shown["key"] in keys else 0
        place = places[at]
        obj = next(one for one in tracks_in(scene) if one.unisim.uid == place.uid)
        clock = Clock.of(source_of(scene).drive)
        frame = round(float(clock.frame(np.array(place.time_s))))
        scene.frame_set(min(max(frame, scene.frame_start), scene.frame_end))
        choose(context, obj)
        look_at(context, obj)
        text = f"{obj.name} {localized(Text(PLACE_TEXTS[place.kind], value=place.value))}"
        scene.unisim_tracks.place = json.dumps({"key": keys[at], "text": text, "number": at + 1, "count": len(places)})


class UNISIM_OT_dismiss_doubtful(EditsObjects, bpy.types.Operator):
    """Note that the doubtful place that is shown is right, also in the file of boxes, and go to the next one"""

    bl_label = "Dismiss"

    @staticmethod
    def shows_place(context: bpy.types.Context) -> Need:
        """A doubtful place is shown."""
        return context.scene.unisim_tracks.place, "Go to a doubtful place first"

    needs = (object_mode, boxes_there, shows_place)

    def edit(self, context: bpy.types.Context) -> set[str]:
        scene = context.scene
        uid, time_s, kind = json.loads(scene.unisim_tracks.place)["key"]
        for obj in tracks_in(scene):
            if obj.unisim.uid == uid:
                track = track_of(obj, Clock.of(source_of(scene).drive), displaced=False)
                noted = replace(track, dismissed=(*track.dismissed, (time_s, kind)))
                obj.unisim_track.track = json.dumps(track_to_json(noted))
        return set(bpy.ops.unisim.next_doubtful())


def look_at(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Show a box: through the camera that sees it best, and in the middle of other views."""
    scene, best = context.scene, (0.0, None)
    for camera in imported_objects(scene, "CAMERA"):
        model = camera_model_of(camera)
        local = np.array(camera.matrix_world.inverted() @ obj.matrix_world.translation, float) * [1.0, -1.0, -1.0]
        u, v, valid = model.project(local)
        inside = bool(valid) and 0 <= u <= model.width and 0 <= v <= model.height
        nearness = 1 / max(1.0, float(np.linalg.norm(local))) if inside else 0.0
        if nearness > best[0]:
            best = nearness, camera
    if best[1] is not None:
        scene.camera = best[1]
    for area in areas("VIEW_3D"):
        looks, space = area.spaces.active.region_3d, area.spaces.active
        if looks is not None and looks.view_perspective != "CAMERA" and space.lock_object is None:
            looks.view_location = obj.matrix_world.translation


class UNISIM_OT_save_boxes(Needing, AtOnce, bpy.types.Operator):
    """Save the boxes beside the log, and use them as its actors: in training, edits, images and simulations"""

    bl_label = "Save Boxes"
    bl_options = {"REGISTER"}
    needs = (object_mode, boxes_there)

    def work(self: Any, context: bpy.types.Context) -> Generator[str | None, None, None]:
        scene = context.scene
        source, least = source_of(scene), scene.unisim_tracks.certainty
        if source.log is None:
            raise UnisimError(message("{log}: is not at hand; boxes are saved beside it", log=source.log_path))
        tracks = saved_tracks([obj for obj in tracks_in(scene) if obj.unisim_track.certainty >= least], source)
        path, log = default_path(source.log_path), source.log
        yield message("Saving {count} boxes", count=len(tracks))
        yield from in_thread(lambda: write_boxes(path, log, tracks, "Blender"))
        if source.scene_path is not None:
            self.report({"WARNING"}, message("{path}: is saved; train a scene on it to use it", path=path))
            return
        saved = yield from in_thread(lambda: open_source(str(path), ""))
        take_tracks(scene)
        exchange_actors(scene, source.drive, saved)
        scene.frame_set(scene.frame_current)  # what is shown of a frame is of the log that is open now
        scene.unisim_tracks.place = ""
        self.report(
            {"INFO"}, message("{path}: {count} boxes are the actors of the log now", path=path, count=len(tracks))
        )

    def finished(self: Any, context: bpy.types.Context) -> None:
        bpy.ops.ed.undo_push(message=self.bl_label)


class UNISIM_OT_discard_boxes(EditsObjects, bpy.types.Operator):
    """Remove all boxes that are not saved; the actors of the log are shown again"""

    bl_label = "Discard Boxes"
    needs = (object_mode, boxes_there)

    def edit(self, context: bpy.types.Context) -> None:
        take_tracks(context.scene)
