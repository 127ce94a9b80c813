"""Outputs of an autonomy stack, and labels, as a JSON document; docs/reference/metrics.md describes it. Intersection over
union of its boxes: seen from above, turned by any angle, and upright in an image."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import UnisimError, short
from ...files import write_file
from ...geometry import BoolArray, FloatArray, convex_intersection_area
from ...json_file import Node, read_json


def bev_corners(boxes: FloatArray) -> FloatArray:
    """Corners (N, 4, 2), counter-clockwise from the front left, of boxes (N, 5): x, y, length, width, yaw (m, rad)."""
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2
    local = signs * boxes[:, None, 2:4]
    cosine, sine = np.cos(boxes[:, 4]), np.sin(boxes[:, 4])
    rotation = np.stack([np.stack([cosine, sine], -1), np.stack([-sine, cosine], -1)], 1)
    return np.asarray(local @ rotation + boxes[:, None, :2])


def bev_iou(a: FloatArray, b: FloatArray) -> FloatArray:
    """IoU (N, M) of boxes (N, 5) and (M, 5): x, y, length, width, yaw."""
    reach = (np.hypot(a[:, 2], a[:, 3])[:, None] + np.hypot(b[:, 2], b[:, 3])) / 2
    rows, columns = np.nonzero(np.hypot(a[:, None, 0] - b[:, 0], a[:, None, 1] - b[:, 1]) < reach)
    first, second = a[rows].copy(), b[columns].copy()
    second[:, :2] -= first[:, :2]  # near the origin nothing is lost to large coordinates
    first[:, :2] = 0.0
    shared = convex_intersection_area(bev_corners(first), bev_corners(second))
    out = np.zeros((len(a), len(b)))
    out[rows, columns] = shared / (a[rows, 2] * a[rows, 3] + b[columns, 2] * b[columns, 3] - shared)
    return out


def image_iou(a: FloatArray, b: FloatArray) -> FloatArray:
    """IoU (N, M) of boxes (N, 4) and (M, 4): left, top, right, bottom."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    shared = np.prod(np.maximum(high - low, 0.0), -1)
    area_a, area_b = np.prod(a[:, 2:] - a[:, :2], -1), np.prod(b[:, 2:] - b[:, :2], -1)
    return np.asarray(shared / (area_a[:, None] + area_b - shared))


def without_duplicates(iou: FloatArray, scores: FloatArray, most: float) -> list[int]:
    """Boxes that stay, best first, when each takes away those of lower score that overlap it by more than ``most``.

    iou (N, N), scores (N,). Greedy non-maximum suppression; of equal scores the first stays.
    """
    best: list[int] = []
    left = np.ones(len(scores), bool)
    for index in np.argsort(-scores, kind="stable"):
        if left[index]:
            best.append(int(index))
            left &= iou[index] <= most
    return best


FORMAT, VERSION = "unisim-autonomy", 1
KINDS = {"bev": 5, "image": 4}
"""Kinds of boxes, and how many numbers each has: x, y, length, width, yaw (m, rad), or left, top, right, bottom
(pixels)."""
IOU = {"bev": bev_iou, "image": image_iou}
DEFAULT_CLASS = "object"


class MetricsError(UnisimError):
    """A document of outputs or labels that is not valid, or two that do not belong together."""


@dataclass(frozen=True)
class Forecast:
    """K ways an actor may go: modes (K, T, 2) and their probabilities (K,)."""

    modes: FloatArray
    probabilities: FloatArray


@dataclass(frozen=True)
class FrameOutput:
    """A frame's N boxes (N, 5) or (N, 4), scores (N,), classes, ignored (N,), forecasts; and the plan (T, 2),
    if any."""

    boxes: FloatArray
    scores: FloatArray
    classes: tuple[str, ...]
    ignored: BoolArray
    forecasts: tuple[Forecast | None, ...] = ()
    plan: FloatArray | None = None


FrameKey = tuple[str, int | str]
"""A sequence, and a frame's number or the name of a time ("t0000001050000us")."""


@dataclass(frozen=True)
class ModelOutputs:
    """A document: what its boxes are, and frames by sequence and number. ``scored``: every box has a score."""

    kind: str
    frames: dict[FrameKey, FrameOutput]
    scored: bool = True
    path: Path = field(default=Path("outputs.json"), compare=False)


def read_outputs(path: Path) -> ModelOutputs:
    """The document at ``path``. Raises `MetricsError`."""
    root = Node(read_json(path, MetricsError), f"{path}: ", MetricsError)
    if root.object().get("format") != FORMAT:
        raise MetricsError(f'{path}: format: must be "{FORMAT}", not {short(root.value.get("format"))}')
    version = root.key("version").integer(at_least=1)
    if version > VERSION:
        raise MetricsError(f"{path}: has version {version}, newer than the {VERSION} that this program reads")
    kind = root.key("boxes").text()
    if kind not in KINDS:
        root.key("boxes").fail(f"must be one of {', '.join(KINDS)}, not {short(kind)}")
    frames: dict[FrameKey, FrameOutput] = {}
    scored = True
    for node in root.key("frames").elements():
        _known(node, {"sequence", "frame", "boxes", "plan"})
        frame = node.key("frame")
        number = frame.text() if isinstance(frame.value, str) else frame.integer()
        key = (node.key("sequence").text() if "sequence" in node.value else "", number)
        if key in frames:
            node.fail(f"{_named(key)} is there twice")
        frames[key], has_scores = _read_frame(node, kind)
        scored &= has_scores
    return ModelOutputs(kind, frames, scored, path)


def _read_frame(node: Node, kind: str) -> tuple[FrameOutput, bool]:
    boxes, scores, classes, ignored, forecasts = [], [], [], [], []
    scored = True
    for box in node.key("boxes").elements():
        _known(box, {"box", "score", "class", "ignored", "modes"})
        boxes.append(_read_box(box.key("box"), kind))
        scored &= "score" in box.value
        scores.append(box.key("score").number() if "score" in box.value else 1.0)
        classes.append(box.key("class").text() if "class" in box.value else DEFAULT_CLASS)
        ignored.append(box.key("ignored").flag() if "ignored" in box.value else False)
        forecasts.append(_read_forecast(box.key("modes")) if "modes" in box.value else None)
    plan = node.key("plan").array(-1, 2) if "plan" in node.value else None
    if plan is not None and not len(plan):
        node.key("plan").fail("has no position")
    frame = FrameOutput(
        np.array(boxes, np.float64).reshape(-1, KINDS[kind]), np.array(scores, np.float64), tuple(classes),
        np.array(ignored, bool), tuple(forecasts), plan,
    )  # fmt: skip
    return frame, scored


def _read_box(node: Node, kind: str) -> FloatArray:
    box = node.array(KINDS[kind])
    sides = box[2:4] if kind == "bev" else box[2:] - box[:2]
    if (sides <= 0).any():
        names = "length and width" if kind == "bev" else "right - left and bottom - top"
        node.fail(f"{names} must be above 0, not {sides[0]:g} and {sides[1]:g}")
    return box


def _read_forecast(node: Node) -> Forecast:
    positions: list[FloatArray] = []
    probabilities = []
    for mode in node.elements():
        _known(mode, {"positions", "probability"})
        trajectory = mode.key("positions").array(-1, 2)
        if not len(trajectory) or (positions and len(trajectory) != len(positions[0])):
            mode.key("positions").fail("must have as many positions as the other modes, and at least one")
        positions.append(trajectory)
        probabilities.append(mode.key("probability").number() if "probability" in mode.value else 1.0)
    if not positions:
        node.fail("has no mode")
    return Forecast(np.stack(positions), np.array(probabilities))


def write_outputs(path: Path, outputs: ModelOutputs) -> None:
    """Write a document that `read_outputs` reads. Raises `MetricsError`."""
    from json import dumps

    document = {
        "format": FORMAT,
        "version": VERSION,
        "boxes": outputs.kind,
        "frames": [_frame_to_json(key, frame, outputs.scored) for key, frame in outputs.frames.items()],
    }
    write_file(path, dumps(document, indent=1) + "\n", MetricsError)


def _frame_to_json(key: FrameKey, frame: FrameOutput, scored: bool) -> dict[str, Any]:
    boxes: list[dict[str, Any]] = []
    for index, box in enumerate(frame.boxes):
        item: dict[str, Any] = {"box": box.tolist(), "class": frame.classes[index]}
        if scored:
            item["score"] = float(frame.scores[index])
        if frame.ignored[index]:
            item["ignored"] = True
        forecast = frame.forecasts[index] if frame.forecasts else None
        if forecast is not None:
            pairs = zip(forecast.probabilities.tolist(), forecast.modes.tolist(), strict=True)
            item["modes"] = [{"probability": probability, "positions": trajectory} for probability, trajectory in pairs]
        boxes.append(item)
    plan = {} if frame.plan is None else {"plan": frame.plan.tolist()}
    return {"sequence": key[0], "frame": key[1], "boxes": boxes, **plan}


def check_pair(outputs: ModelOutputs, labels: ModelOutputs) -> None:
    """Raise `MetricsError` unless both have the same kind of boxes and the same frames."""
    if outputs.kind != labels.kind:
        raise MetricsError(f"{outputs.path}: boxes: are {outputs.kind}, those of {labels.path} are {labels.kind}")
    for document, other in ((outputs, labels), (labels, outputs)):
        lacking = [key for key in other.frames if key not in document.frames]
        if lacking:
            raise MetricsError(f"{document.path}: has no {_named(lacking[0])}, which {other.path} has")
    if not labels.frames:
        raise MetricsError(f"{labels.path}: frames: there is none")


def _named(key: FrameKey) -> str:
    return f"frame {key[1]}" + (f" of sequence {key[0]!r}" if key[0] else "")


def _known(node: Node, names: set[str]) -> None:
    unknown = sorted(set(node.object()) - names)
    if unknown:
        node.fail(f"{short(unknown[0])} is none of {', '.join(sorted(names))}")
