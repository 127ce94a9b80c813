"""An edit session in Blender as a script: what a person would do with the mouse, with the times that it takes.

python examples/edit_session.py SCENE OUT      (SCENE: a trained scene's folder, its log where the header says)

The car ahead is deleted, another one copied into the next lane and slowed down, four cones are copied, the vehicle
drives a metre further left; then an image, and all sensors of five frames, from the scenario that stays in OUT.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import numpy as np

import unisim_blender
from unisim_blender.bridge.importing.drive import fit_resolution
from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.core.model.scene_file import read_scene_header

FRAMES = 5
CONES_AHEAD_M = (12.0, 15.0, 18.0, 21.0)


@contextmanager
def timed(what: str) -> Iterator[None]:
    """Print how long something takes."""
    begun = time.monotonic()
    yield
    print(f"{what:50s} {time.monotonic() - begun:7.2f} s", flush=True)


def select(*chosen: Any) -> None:
    """Select these and nothing else."""
    for other in bpy.context.selected_objects:
        other.select_set(False)
    for one in chosen:
        one.select_set(True)
        bpy.context.view_layer.objects.active = one


def main(trained: Path, out: Path) -> None:
    """The session."""
    unisim_blender.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    with timed("import"):
        bpy.ops.unisim.import_scene(filepath=str(trained / "scene.json"))
    scene.camera = next(obj for obj in imported_objects(scene, "CAMERA") if obj.unisim.uid == trained_camera(trained))
    fit_resolution(scene)
    drive = source_of(scene).drive
    # one camera and one LiDAR: what is deleted is not rendered
    rig = [obj for obj in imported_objects(scene, "LIDAR") if drive.lidars[obj.unisim.uid].model.beams][:1] + [
        scene.camera
    ]
    for sensor in [obj for obj in imported_objects(scene, "CAMERA", "LIDAR") if obj not in rig]:
        bpy.data.objects.remove(sensor)
    middle = drive.frames[len(drive.frames) // 2]
    scene.frame_set(middle)
    ego = np.array(next(imported_objects(scene, "EGO")).matrix_world)
    boxes = {
        obj: np.linalg.inv(ego) @ np.array(obj.matrix_world)
        for obj in imported_objects(scene, "ACTOR")
        if not obj.hide_viewport
    }
    driving = [
        obj for obj in boxes if drive.actors[obj.unisim.uid].is_moving and "Car" in drive.actors[obj.unisim.uid].label
    ]
    ahead = sorted((obj for obj in driving if boxes[obj][0, 3] > 4), key=lambda obj: boxes[obj][0, 3])
    cone = next((obj for obj in boxes if "Cone" in drive.actors[obj.unisim.uid].label), None)

    with timed("edits"):
        leader = min(ahead[:4], key=lambda obj: abs(boxes[obj][1, 3]))
        print("deleted:", leader.name)
        other = next(obj for obj in ahead if obj is not leader)
        select(leader)
        bpy.ops.unisim.delete_actor()
        select(other)
        bpy.ops.unisim.duplicate_actor(where="LANE_LEFT")
        print("copied:", bpy.context.active_object.name)
        bpy.ops.unisim.retime_actor(mode="SPEED", speed=0.7)
        if cone is not None:
            for metres in CONES_AHEAD_M:
                select(cone)
                place = ego @ np.array([metres, -1.6, 0, 1])
                scene.cursor.location = place[:3]
                bpy.ops.unisim.duplicate_actor(where="CURSOR")
                bpy.ops.unisim.snap_to_ground()
        bpy.ops.unisim.shift_ego(left_m=1.0)
    with timed("check"):
        bpy.ops.unisim.check()
    for warning in bpy.context.window_manager.unisim_warnings:
        print("warning:", warning.frame, warning.name, warning.text)

    scene.frame_set(middle)
    scene.render.engine = "UNISIM"
    scene.render.image_settings.file_format = "PNG"
    out.mkdir(parents=True, exist_ok=True)
    for what in ("F12, the worker's start with it", "F12 again"):
        scene.render.filepath = str(out / "f12.png")
        with timed(f"{what}, {scene.render.resolution_x} x {scene.render.resolution_y}"):
            bpy.ops.render.render(write_still=True)
    scene.frame_start, scene.frame_end = middle, middle + FRAMES - 1
    scene.unisim.out = str(out / "sequence")
    with timed(f"sequence, {FRAMES} frames of all sensors"):
        bpy.ops.unisim.render_sequence()
    with timed("the same by unisim render"):
        scenario = out / "sequence" / "scenario.json"
        command = [sys.executable, "-m", "unisim_blender", "render", str(scenario), "--out", str(out / "again")]
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    first, second = digests(out / "sequence"), digests(out / "again")
    print(f"{len(first)} files, the same bytes: {first == second}")
    unisim_blender.unregister()


def trained_camera(trained: Path) -> str:
    """The first camera that a scene was trained on."""
    return str(read_scene_header(trained).training["cameras"][0])


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of what a render wrote, but its times and the scenario."""
    files = sorted(
        path for path in folder.rglob("*") if path.is_file() and path.name not in ("timings.json", "scenario.json")
    )
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


if __name__ == "__main__":
    main(Path(sys.argv[1]).absolute(), Path(sys.argv[2]).absolute())
