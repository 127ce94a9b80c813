"""What detectors recall of the labelled actors of frames: labels of images and sweeps, and recall at a least score.

Intervals are of resampled actors: frames of one actor are alike.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..data.log import Log
from ..geometry import UNIT_BOX_CORNERS, FloatArray, invert_pose, points_in_box, transform_points
from ..sensors.camera import line_count, line_times, lines
from ..world.drive import Actor, Camera, Drive
from .autonomy.document import IOU
from .autonomy.measure import AGREEMENT_IOU, Matches, best_f1, interval, match, resampled_weights

MIN_RETURNS, MIN_HEIGHT, MIN_INSIDE, MAX_HIDDEN = 5, 0.03, 0.3, 0.7
"""A label counts where so many returns of the recorded sweep hit it; in an image also where it is this high (of the image's
width), so much of its rectangle is in the image, and no more than this lies behind the rectangles of nearer labels."""
REACH_M = ((0.0, 80.0), (-40.0, 40.0))
"""Where labels of sweeps count, x and y in the ego frame: the paper's region."""
SURFACE_M = 0.05
_ON_BOX = np.concatenate([a + np.linspace(0, 1, 16)[:, None] * (b - a) for a, b in combinations(UNIT_BOX_CORNERS, 2)])
"""Points (N, 3) between the corners of a box whose edges are 1."""
RESAMPLES, SEED = 1000, 0

Detections = tuple[FloatArray, FloatArray, Sequence[str]]
"""Boxes (N, 4 or 5) as documents of `autonomy.document` have them, scores (N,), and classes."""


class ShiftDetector(Protocol):
    """Detects actors. ``classes``: for each class that it names, the labels of logs that it stands for."""

    classes: Mapping[str, Sequence[str]]

    def in_image(self, rgb: NDArray[np.uint8]) -> Detections:
        """Return left, top, right, bottom in pixels of what is in an image (H, W, 3), sRGB."""

    def in_sweep(self, points: FloatArray) -> Detections:
        """Return x, y, length, width, yaw of what is in returns (N, 4): x, y, z, intensity; ego frame, metres, radians."""


FrameOfSensor = tuple[str, int]
LabelKey = tuple[FrameOfSensor, str]
"""A label: a frame of a sensor, and an actor's uid."""


@dataclass(frozen=True)
class LabelledFrame:
    """Labels of one frame: boxes (N, 4 or 5), uids, the log's label of each, and which do not count (N,)."""

    boxes: FloatArray
    uids: tuple[str, ...]
    labels: tuple[str, ...]
    ignored: NDArray[np.bool_]


@dataclass
class Recall:
    """What a detector saw of one class at one shift: the score (-inf: none) of each label that counts by frame and uid, and
    by frame the scores of detections of nothing."""

    scores: dict[LabelKey, float] = field(default_factory=dict)
    false_alarms: dict[FrameOfSensor, list[float]] = field(default_factory=dict)

    def add(
        self,
        frame: FrameOfSensor,
        labels: LabelledFrame,
        detections: Detections,
        name: str,
        kind: str,
        of: Sequence[str],
    ) -> None:
        """Count a frame's detections of class ``name`` beside the labels ``of`` its actors."""
        boxes, scores, classes = detections
        mine = np.array([given == name for given in classes], bool)
        boxes, scores = boxes[mine], scores[mine]
        chosen = np.array([label in of for label in labels.labels], bool)
        uids = [uid for uid, taken in zip(labels.uids, chosen, strict=True) if taken]
        ignored = labels.ignored[chosen]
        matched = match(IOU[kind](boxes, labels.boxes[chosen]), scores, ignored, AGREEMENT_IOU)
        best = dict.fromkeys((i for i in range(len(uids)) if not ignored[i]), -np.inf)
        best |= {int(label): float(score) for label, score in zip(matched, scores, strict=True) if label >= 0}
        self.scores |= {(frame, uids[i]): score for i, score in best.items()}
        self.false_alarms[frame] = scores[matched == -1].tolist()

    def of_frames(self, frames: Collection[int]) -> Recall:
        """Return what was seen in frames of these numbers alone."""
        return Recall(
            {key: score for key, score in self.scores.items() if key[0][1] in frames},
            {frame: scores for frame, scores in self.false_alarms.items() if frame[1] in frames},
        )

    def _false_scores(self) -> list[float]:
        return [score for scores in self.false_alarms.values() for score in scores]

    def least_score(self) -> float:
        """Return the score of the best F1; inf where nothing is found."""
        found = [score for score in self.scores.values() if np.isfinite(score)]
        scores = np.array(found + self._false_scores())
        hit = np.arange(len(scores)) < len(found)
        order = np.argsort(-scores, kind="stable")
        labels = np.array([float(len(self.scores))])
        return best_f1(Matches(scores[order], hit[order], np.zeros(len(scores), np.int64), labels))[1]

    def metrics(self, least: float, recorded: Recall) -> dict[str, Any]:
        """Recall of detections of at least that score, and how much lower it is than the recorded frames' of the same labels,
        with intervals of resampled actors; false alarms a frame; as JSON has it."""
        metrics: dict[str, Any] = {
            "labels": len(self.scores),
            "actors": len({uid for _, uid in self.scores}),
            "frames": len(self.false_alarms),
            "false_alarms": _ratio(sum(score >= least for score in self._false_scores()), len(self.false_alarms)),
        }
        metrics["recall"] = _resampled(_by_actor((key, score >= least) for key, score in self.scores.items()))
        lost = self._lost(least, recorded)
        return {**metrics, "lost": {"labels": sum(map(len, lost.values())), **_resampled(lost)}}

    def _lost(self, least: float, recorded: Recall) -> dict[str, list[float]]:
        """By actor, for each label of both: 1 where the recorded frame's alone is seen, -1 where it alone is not."""
        both = ((key, recorded.scores[key], score) for key, score in self.scores.items() if key in recorded.scores)
        return _by_actor((key, float(before >= least) - float(score >= least)) for key, before, score in both)


def lost_per_metre(row: Mapping[float, Recall], least: float, recorded: Recall) -> dict[str, Any]:
    """Return how much recall of the same labels is lost for each metre beside the path, the least squares' slope over a row's
    shifts, with the interval of resampled actors; None where there are fewer than two distances."""
    lost = [recall._lost(least, recorded) for recall in row.values()]
    uids = sorted({uid for by_actor in lost for uid in by_actor})
    total, count = (
        np.array([[reduce(by_actor.get(uid, ())) for by_actor in lost] for uid in uids]) for reduce in (sum, len)
    )
    x = np.abs(np.array(list(row)))
    if not uids or len(set(x[count.sum(0) > 0])) < 2:
        return {"value": None, "interval": [None, None]}
    drawn = np.concatenate([np.ones((1, len(uids))), resampled_weights(len(uids), RESAMPLES, SEED)])
    w, wy = drawn @ count, drawn @ total  # labels at each shift, and the sums of what is lost
    off = x - (w @ x / w.sum(1))[:, None]
    with np.errstate(invalid="ignore"):  # actors that are drawn may have labels at one distance alone
        slopes = (off * wy).sum(1) / (off**2 * w).sum(1)
    return {"value": float(slopes[0]), "interval": list(interval(slopes[1:]))}


def _by_actor(values: Iterable[tuple[LabelKey, float]]) -> dict[str, list[float]]:
    out: dict[str, list[float]] = {}
    for key, value in values:
        out.setdefault(key[1], []).append(value)
    return out


def _ratio(part: float, whole: float) -> float | None:
    return part / whole if whole else None


def _resampled(values: Mapping[str, list[float]]) -> dict[str, Any]:
    """The mean of labels' values, by actor, and the middle 95 % of it over resampled actors; None where there are none."""
    if not values:
        return {"value": None, "interval": [None, None]}
    total, count = (np.array([reduce(of_actor) for of_actor in values.values()], np.float64) for reduce in (sum, len))
    weights = resampled_weights(len(total), RESAMPLES, SEED)
    return {
        "value": float(total.sum() / count.sum()),
        "interval": list(interval((weights @ total) / (weights @ count))),
    }


def label_image(drive: Drive, camera: Camera, frame: int, returns: Mapping[str, int]) -> LabelledFrame:
    """Label the actors in a camera's image. ``returns``: how many returns of the recorded sweep hit each."""
    model, time_s = camera.model, camera.time_s[frame]
    at: list[tuple[float, Actor, FloatArray, float]] = []
    for actor in drive.actors.values():
        if not actor.present(time_s):
            continue
        row_s = time_s
        for _ in range(2):  # the line that shows its middle tells the time, and the time the line
            pose = invert_pose(camera.world_from_camera.at(row_s)) @ actor.world_from_actor.at(row_s)
            u, v, valid = model.project(transform_points(pose, _ON_BOX * actor.size_m))
            if not valid.any():
                break
            whole = np.array([u[valid].min(), v[valid].min(), u[valid].max(), v[valid].max()])
            line = lines(model, whole[[0, 2]].mean(keepdims=True), whole[[1, 3]].mean(keepdims=True))
            row_s = float(line_times(camera, time_s, np.clip(line, 0, line_count(model)))[0])
        if not valid.any():
            continue
        box = np.clip(whole, 0, [model.width, model.height] * 2)
        area = float(np.prod(box[2:] - box[:2]))
        if area > 0:
            inside = area / float(np.prod(whole[2:] - whole[:2]))
            at.append((float(np.linalg.norm(pose[:3, 3])), actor, box, inside))
    at.sort(key=lambda entry: entry[0])
    covered, ignored = np.zeros((model.height, model.width), bool), []
    for _, actor, box, inside in at:
        left, top, right, bottom = box.round().astype(int)
        region = covered[top:bottom, left:right]
        hidden = region.mean() if region.size else 0.0
        region[:] = True
        low = box[3] - box[1] < MIN_HEIGHT * model.width
        ignored.append(low or inside < MIN_INSIDE or hidden > MAX_HIDDEN or returns.get(actor.uid, 0) < MIN_RETURNS)
    return LabelledFrame(
        np.array([box for *_, box, _ in at]).reshape(-1, 4),
        tuple(actor.uid for _, actor, *_ in at),
        tuple(actor.label for _, actor, *_ in at),
        np.array(ignored, bool),
    )


def label_sweep(drive: Drive, frame: int, sweep_s: float, returns: Mapping[str, int]) -> LabelledFrame:
    """Label the actors round the ego at the middle of a sweep that takes ``sweep_s``; ``returns`` as of `label_image`."""
    time_s = drive.time_s[frame]
    ego_from_world = invert_pose(drive.world_from_ego.at(time_s))
    boxes, actors = [], [actor for actor in drive.actors.values() if actor.present(time_s)]
    for actor in actors:
        pose = ego_from_world @ actor.world_from_actor.at(time_s - sweep_s / 2)
        boxes.append([*pose[:2, 3], *actor.size_m[:2], np.arctan2(pose[1, 0], pose[0, 0])])
    at = np.array(boxes).reshape(-1, 5)
    inside = np.all([(at[:, i] >= low) & (at[:, i] < high) for i, (low, high) in enumerate(REACH_M)], 0)
    few = np.array([returns.get(actor.uid, 0) < MIN_RETURNS for actor in actors], bool)
    return LabelledFrame(at, tuple(a.uid for a in actors), tuple(a.label for a in actors), few | ~inside)


def returns_of(log: Log, lidars: Sequence[str], frame: int) -> dict[str, int]:
    """Count the returns of a frame's recorded sweeps that hit each actor."""
    out: dict[str, int] = {}
    for name in lidars:
        if frame not in log.sweep_frames(name):
            continue
        points, lidar = log.sweep(name, frame).points, log.drive.lidars[name]
        time_s = lidar.time_s[frame] - lidar.model.sweep_s / 2
        for actor in log.drive.actors.values():
            if actor.present(time_s):
                inside = points_in_box(points, actor.world_from_actor.at(time_s), actor.size_m + 2 * SURFACE_M)
                out[actor.uid] = out.get(actor.uid, 0) + int(inside.sum())
    return out
