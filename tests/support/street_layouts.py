"""The procedural street in every layout that is read, with images of it, and what is true of it in each.

python street_layouts.py OUT   writes a folder for each layout that can be written here, and OUT/truth.json
"""

from __future__ import annotations

import json
import pickle
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import argoverse2_street
import kitti_street
import ncore_street
import numpy as np
import nuscenes_street
import waymo_street
from written_once import written_once

from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.world.drive import Camera, Drive


@dataclass(frozen=True)
class Written:
    """A log of the street. ``log`` is what a reader opens, ``dropped`` one of its files that a window is given; ``drive`` is the
    street's, whose clock is ``later_s`` ahead of the log's, and whose world is ``common_from_street`` in the coordinates
    that the log's world was moved from; ``cameras`` are those that the log has, in the street's world, by the log's names.
    ``box_m``: how far from the truth the layout's boxes may be."""

    log: Path
    dropped: Path
    drive: Drive
    cameras: Mapping[str, Camera]
    common_from_street: FloatArray
    later_s: float
    box_m: float


def moved(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> FloatArray:
    """A pose that is no rotation."""
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def pandaset(root: Path, size: int) -> Written:
    """PandaSet's layout, with the street's recipe."""
    from written_street import write_recipe

    from unisim_street.street import build_street

    write_recipe(root, seed=11, frames=4, width=96 * size, height=54 * size)
    drive = build_street(seed=11, frames=4, width=96 * size, height=54 * size).drive
    dropped = root / "lidar" / "poses.json"
    return Written(root, dropped, drive, drive.cameras, moved(*drive.world_origin), 0.0, 1e-3)


def ncore(root: Path, size: int) -> Written:
    """NVIDIA's NCore."""
    drive = ncore_street.write(root, 96 * size).drive
    dropped = next(root.glob("*.json"))
    return Written(root, dropped, drive, drive.cameras, moved(*drive.world_origin), 0.0, 1e-3)


def argoverse2(root: Path, size: int) -> Written:
    """Argoverse 2's sensor dataset."""
    made = argoverse2_street.Argoverse2Street(enlarged=2 * size)
    made.write(root)
    dropped, camera = root / "annotations.feather", made.camera()
    return Written(root, dropped, made.street.drive, {camera.sensor_id: camera}, moved(*made.city), 0.0, 0.05)


def nuscenes(root: Path, size: int) -> Written:
    """nuScenes v1.0."""
    made = nuscenes_street.write(root, enlarged=size)
    turned, place = nuscenes_street.MAP
    pose = moved(*place)
    pose[:3, :3] = turned.as_matrix()
    cameras = {name: nuscenes_street.camera(made, name) for name in nuscenes_street.CAMERAS}
    dropped = root / nuscenes_street.sweep_file(0)
    return Written(root, dropped, made.street.drive, cameras, pose, nuscenes_street.FIRST_S, 0.15)


def kitti(root: Path, size: int) -> Written:
    """A raw drive of KITTI's."""
    path = root / "2011_09_26" / "2011_09_26_drive_0001_sync"
    made = kitti_street.record(path, 1, enlarged=size)
    kitti_street.write_raw(made)
    start = mercator() - made.ego(np.zeros(1))[1][0]
    cameras = {f"image_{number:02d}": kitti_street.camera(made, number) for number in (2, 3)}
    dropped = path / "oxts" / "timestamps.txt"
    return Written(path, dropped, made.street.drive, cameras, moved(*start), kitti_street.TRIGGER_S, 0.05)


def mercator() -> FloatArray:
    """Where the street's place in Karlsruhe is in Mercator's projection at the scale of its latitude, metres."""
    latitude, longitude = np.radians([kitti_street.LATITUDE, kitti_street.LONGITUDE])
    scale = np.cos(latitude) * kitti_street.EARTH_M
    return np.array([scale * longitude, scale * np.log(np.tan(np.pi / 4 + latitude / 2)), kitti_street.ALTITUDE])


def waymo(root: Path, size: int) -> Written:
    """Waymo Open's perception dataset v2."""
    made = waymo_street.WaymoStreet(enlarged=2 * size)
    made.write(root)
    cameras = {name: made.camera(lens) for name, lens in zip(("front", "side_left"), made.cameras, strict=True)}
    dropped = root / "vehicle_pose" / f"{waymo_street.SEGMENT}.parquet"
    return Written(root, dropped, made.street.drive, cameras, moved(*waymo_street.GLOBAL), 0.0, 0.05)


WRITERS: Mapping[str, Callable[[Path, int], Written]] = {
    "pandaset": pandaset,
    "ncore": ncore,
    "argoverse2": argoverse2,
    "nuscenes": nuscenes,
    "kitti": kitti,
    "waymo": waymo,
}


def copy_of(layout: str) -> Callable[[Path, int], Written]:
    """Return the layout's writer; several that write the same in a run of the tests copy what the first one wrote."""

    def write(root: Path, size: int) -> Written:
        def first(folder: Path) -> None:
            made = WRITERS[layout](folder, size)
            inside = replace(made, log=made.log.relative_to(folder), dropped=made.dropped.relative_to(folder))
            (folder / "written.pickle").write_bytes(pickle.dumps(inside))

        about = written_once(root, f"layout-{layout}-{size}", first) / "written.pickle"
        made: Written = pickle.loads(about.read_bytes())
        about.unlink()
        return replace(made, log=root / made.log, dropped=root / made.dropped)

    return write


LAYOUTS: Mapping[str, Callable[[Path, int], Written]] = {layout: copy_of(layout) for layout in WRITERS}
"""What writes the street into a folder, images by a size; by a reader's name."""


def true_boxes(written: Written, time_s: float, world_origin: FloatArray) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Pose (4, 4) and size (3,) of the street's actors by their ids, at a time of the log's, in its world."""
    street_s = time_s + written.later_s
    move = moved(*-np.asarray(world_origin)) @ written.common_from_street
    return {
        uid: (move @ actor.world_from_actor.at(street_s), actor.size_m)
        for uid, actor in written.drive.actors.items()
        if actor.present(street_s)
    }


def main(out: Path) -> None:
    """Write them all, and what of them is true."""
    from unisim_blender.core.formats.readers import open_log

    truth = {}
    for name, write in LAYOUTS.items():
        written = write(out / name, 5)
        drive = open_log(written.log).drive
        boxes = [
            {uid: pose[:3, 3].tolist() for uid, (pose, _) in true_boxes(written, time, drive.world_origin).items()}
            for time in drive.time_s.values()
        ]
        truth[name] = {
            "dropped": str(written.dropped.relative_to(out)),
            "boxes": boxes,
            "box_m": written.box_m,
            "cameras": {n: [c.model.width, c.model.height] for n, c in written.cameras.items()},
            "bends": [n for n, c in written.cameras.items() if not c.model.is_pinhole],
        }
    (out / "truth.json").write_text(json.dumps(truth, indent=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
