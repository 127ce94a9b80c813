"""Found tracks beside a log's own labels: HOTA, recall, precision, errors and identity switches by range and motion.

python benchmarks/tracks.py LOG BOXES [--json FILE] [--actors]

LOG is a labelled log, BOXES a file of boxes, as of `unisim info --boxes`. Both are placed when the LiDAR's beams pass them in
each frame. Only labels with 5 returns or more count; the others of the same kind are ignored regions, as are labels at other
ranges and of the other motion: boxes within 2 m of one, or with fewer than 5 returns and no label, are neither right nor wrong.
Classes within vehicles (rigid), and within people and cyclists (deforming), are not told apart.

A box is right within 2 m of its label, centre to centre in the plane (nuScenes; Argoverse 2's tracking). HOTA (Luiten et al.,
IJCV 2020) and identity switches are TrackEval's, the extra `tracking`: HOTA of IoU from above, and of 1 - distance / 2 m.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.data.log import Log, extras_of
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.evaluation.autonomy.document import bev_iou
from unisim_blender.core.formats.boxes import with_boxes
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import BoolArray, FloatArray, points_in_box
from unisim_blender.core.progress import Bar
from unisim_blender.core.world.box_tracks import box_poses
from unisim_blender.core.world.classes import motion_of
from unisim_blender.core.world.drive import Drive

LEAST_RETURNS = 5
SAME_M = 2.0
"""Distance, metres, within which a box is its label's."""
KINDS = {"vehicles": "rigid", "people, cyclists": "deforming"}
RANGES_M = ((0, 30), (30, 50), (0, 50))
MOTIONS: dict[str, bool | None] = {"moving": True, "standing": False, "all": None}


@dataclass(frozen=True)
class FrameBoxes:
    """Boxes of one kind in one frame, B of them: uid (B,) numbers of actors, xylwa (B, 5) x, y, length, width, yaw;
    away_m (B,) from the ego vehicle, returns (B,), moving (B,)."""

    uid: NDArray[np.int64]
    xylwa: FloatArray
    away_m: FloatArray
    returns: NDArray[np.int64]
    moving: BoolArray

    def some(self, rows: BoolArray | NDArray[np.int64]) -> FrameBoxes:
        """Return some of the boxes."""
        return FrameBoxes(self.uid[rows], self.xylwa[rows], self.away_m[rows], self.returns[rows], self.moving[rows])


def frame_boxes(
    drive: Drive, lidar: str, frame: int, points: FloatArray, kind: str, numbers: dict[str, int], classes: Any
) -> FrameBoxes:
    """Return the boxes of a kind of motion when the beams of a frame's sweep pass them; ``numbers`` get new actors."""
    actors, poses = box_poses(drive, drive.lidars[lidar], frame)
    rows = [i for i, actor in enumerate(actors) if _kind(actor.label, classes) == kind]
    poses, ego = poses[rows], drive.world_from_ego.at(drive.lidars[lidar].time_s[frame])[:2, 3]
    sizes = np.array([actors[i].size_m for i in rows]).reshape(-1, 3)
    away = np.linalg.norm(poses[:, :2, 3] - ego, axis=1)
    returns = np.zeros(len(rows), np.int64)
    for at, (pose, size) in enumerate(zip(poses, sizes, strict=True)):
        if away[at] < RANGES_M[-1][1] + SAME_M:
            near = (np.abs(points[:, :2] - pose[:2, 3]) < np.linalg.norm(size) / 2).all(1)
            returns[at] = points_in_box(points[near], pose, size).sum()
    yaw = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    return FrameBoxes(
        np.array([numbers.setdefault(actors[i].uid, len(numbers)) for i in rows], np.int64),
        np.column_stack([poses[:, :2, 3], sizes[:, :2], yaw]),
        away,
        returns,
        np.array([actors[i].is_moving for i in rows], bool),
    )


def _kind(label: str, classes: Any) -> str | None:
    """Return the kind of motion of a class; of a bicycle, that nuScenes and Argoverse 2 label for its rider, the rider's."""
    return "deforming" if "bicycle" in label.lower() else motion_of(label, classes)


def distances(a: FrameBoxes, b: FrameBoxes) -> FloatArray:
    """Return the distances (A, B) of boxes' centres in the plane, metres."""
    return np.linalg.norm(a.xylwa[:, None, :2] - b.xylwa[None, :, :2], axis=-1)


def matches(labels: FrameBoxes, boxes: FrameBoxes) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return which labels and boxes (M,) belong together: the nearest pairs within `SAME_M`."""
    from scipy.optimize import linear_sum_assignment

    near = np.maximum(1 - distances(labels, boxes) / SAME_M, 0)
    rows, columns = linear_sum_assignment(-near)
    same = near[rows, columns] > 0
    return rows[same], columns[same]


def counted(labels: FrameBoxes, boxes: FrameBoxes, span_m: tuple[int, int], moving: bool | None) -> list[FrameBoxes]:
    """Return the labels of a range and motion that count, and the boxes that are right or wrong there."""

    def inside(some: FrameBoxes) -> BoolArray:
        here = (some.away_m >= span_m[0]) & (some.away_m < span_m[1]) & (some.returns >= LEAST_RETURNS)
        return here if moving is None else here & (some.moving == moving)

    wanted = inside(labels)
    targets, ignored = labels.some(wanted), labels.some(~wanted)
    counts = inside(boxes) & ~(distances(boxes, ignored) < SAME_M).any(1)
    counts[matches(targets, boxes)[1]] = True
    return [targets, boxes.some(counts)]


def scores(frames: Sequence[Sequence[FrameBoxes]]) -> dict[str, float]:
    """Return the figures of labels and boxes (two for each frame) that count."""
    try:
        from trackeval.metrics import CLEAR, HOTA
    except ImportError as fault:
        raise UnisimError("HOTA needs TrackEval: pip install -e '.[tracking]'") from fault
    centre, heading = [], []
    for labels, boxes in frames:
        rows, columns = matches(labels, boxes)
        centre += distances(labels, boxes)[rows, columns].tolist()
        turned = labels.xylwa[rows, 4] - boxes.xylwa[columns, 4]
        heading += np.degrees(np.abs(np.arctan2(np.sin(turned), np.cos(turned)))).tolist()
    data: dict[str, Any] = {"num_timesteps": len(frames)}
    for side, name in enumerate(("gt", "tracker")):
        every, numbers = np.unique(np.concatenate([pair[side].uid for pair in frames]), return_inverse=True)
        data |= {f"num_{name}_ids": len(every), f"num_{name}_dets": len(numbers)}
        data[f"{name}_ids"] = np.split(numbers, np.cumsum([len(pair[side].uid) for pair in frames])[:-1])
    near = [np.maximum(1 - distances(*pair) / SAME_M, 0) for pair in frames]
    overlap = [bev_iou(labels.xylwa, boxes.xylwa) for labels, boxes in frames]
    by_iou = HOTA().eval_sequence({**data, "similarity_scores": overlap})
    by_distance = HOTA().eval_sequence({**data, "similarity_scores": near})
    clear = CLEAR({"PRINT_CONFIG": False, "THRESHOLD": 1e-6}).eval_sequence({**data, "similarity_scores": near})
    right = clear["CLR_TP"]
    return {
        "labels": data["num_gt_dets"],
        "actors": data["num_gt_ids"],
        "HOTA": 100 * float(np.mean(by_iou["HOTA"])),
        "HOTA 2 m": 100 * float(np.mean(by_distance["HOTA"])),
        "recall": 100 * right / max(data["num_gt_dets"], 1),
        "precision": 100 * right / max(data["num_tracker_dets"], 1),
        "centre m": float(np.median(centre)) if centre else float("nan"),
        "heading deg": float(np.median(heading)) if heading else float("nan"),
        "axis deg": float(np.median(90 - np.abs(90 - np.array(heading)))) if heading else float("nan"),
        "reversed": 100 * float(np.mean(np.array(heading) > 90)) if heading else float("nan"),
        "switches": int(clear["IDSW"]),
    }


def presence(frames: Sequence[Sequence[FrameBoxes]], names: Sequence[str], tracks: Sequence[str]) -> dict[str, Any]:
    """Return for each actor in how many frames it counts, in how many a box is there, and by which tracks."""
    table: dict[str, Any] = {}
    for labels, boxes in frames:
        rows, columns = matches(labels, boxes)
        for uid in labels.uid:
            table.setdefault(names[uid], {"frames": 0, "right": 0, "tracks": []})["frames"] += 1
        for row, column in zip(rows, columns, strict=True):
            about, track = table[names[labels.uid[row]]], tracks[boxes.uid[column]]
            about["right"] += 1
            about["tracks"] += [track] if track not in about["tracks"] else []
    return table


def measured(labelled: Log, boxed: Log) -> tuple[dict[str, dict[str, float]], dict[str, Any]]:
    """Return the figures by kind, motion and range, and the presence of each actor within the last range."""
    drive, classes = labelled.drive, {**extras_of(labelled).classes, **extras_of(boxed).classes}
    lidar = next(iter(drive.lidars))
    numbers: tuple[dict[str, int], dict[str, int]] = {}, {}
    every: dict[str, list[tuple[FrameBoxes, FrameBoxes]]] = {name: [] for name in KINDS}
    for frame in Bar(labelled.sweep_frames(lidar), unit="sweep", delay=0.5):
        there = [name for name in drive.lidars if frame in labelled.sweep_frames(name)]
        points = np.concatenate([labelled.sweep(name, frame).points for name in there])
        for name, kind in KINDS.items():
            own, other = (
                frame_boxes(log.drive, lidar, frame, points, kind, known, classes)
                for log, known in zip((labelled, boxed), numbers, strict=True)
            )
            every[name].append((own, other))
    table: dict[str, dict[str, float]] = {}
    actors: dict[str, Any] = {}
    for name, frames in every.items():
        for motion, moving in MOTIONS.items():
            for span in RANGES_M:
                pairs = [counted(*pair, span, moving) for pair in frames]
                table[f"{name}, {motion}, {span[0]}-{span[1]} m"] = scores(pairs)
        whole = [counted(*pair, RANGES_M[-1], None) for pair in frames]
        actors |= presence(whole, list(numbers[0]), list(numbers[1]))
    for uid, about in actors.items():
        about["class"], about["moves"] = drive.actors[uid].label, drive.actors[uid].is_moving
    return table, actors


@click.command()
@click.argument("log", type=click.Path(path_type=Path))
@click.argument("boxes", type=click.Path(path_type=Path))
@click.option("--json", "out", type=click.Path(path_type=Path), help="Write the figures into this file.")
@click.option("--actors", "shows_actors", is_flag=True, help="Print each actor's presence, too.")
def main(log: Path, boxes: Path, out: Path | None, shows_actors: bool) -> None:
    """Measure BOXES beside the labels of LOG."""
    labelled = open_log(log)
    if not labelled.drive.actors or not labelled.drive.lidars:
        raise UnisimError(f"{log}: has no labels, or no LiDAR that sees them")
    table, actors = measured(labelled, open_log(with_boxes(log, boxes)))
    columns = next(iter(table.values()))
    print(f"{'':38s}" + "".join(f"{name:>12s}" for name in columns))
    for name, row in table.items():
        if row["labels"]:
            cells = (f"{value:12.2f}" if isinstance(value, float) else f"{value:12d}" for value in row.values())
            print(f"{name:38s}" + "".join(cells))
    for uid, about in sorted(actors.items(), key=lambda item: -item[1]["frames"]) if shows_actors else ():
        moves = "moving" if about["moves"] else "standing"
        print(f"{uid} {about['class']} {moves}: {about['right']} of {about['frames']} frames, {about['tracks']}")
    if out is not None:
        out.write_text(json.dumps({"table": table, "actors": actors}, indent=1))


if __name__ == "__main__":
    main()
