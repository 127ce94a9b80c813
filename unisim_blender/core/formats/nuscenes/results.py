"""Results of nuScenes' detection and tracking benchmarks: boxes of key frames in the map's frame, by the tokens of samples."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...errors import LogError
from ...geometry import make_pose
from ...json_file import Node, read_json
from ..common.class_names import class_name
from .scene import BoxRows, quaternion


def read_results(path: Path, samples: Mapping[str, int]) -> BoxRows:
    """Return the boxes of some samples, of which ``samples`` has the times in microseconds, in their order; detections
    have "" for a track. Raises `LogError`."""
    root = Node(read_json(path, LogError), f"{path}: ", LogError)
    results, boxes = root.key("results"), BoxRows()
    there = [token for token in results.object() if token in samples]
    if not there:
        raise LogError(f"{path}: results: has none of the scene's {len(samples)} samples")
    for token in sorted(there, key=lambda token: samples[token]):
        for row in results.key(token).elements():
            task = "tracking" if "tracking_name" in row.object() else "detection"
            width, length, height = row.key("size").array(3)
            if not min(width, length, height) > 0:
                row.key("size").fail(f"must be above 0, not {[width, length, height]}")
            name = row.key(f"{task}_name").text()
            boxes.uid.append(row.key("tracking_id").text() if task == "tracking" else "")
            boxes.label.append(class_name(name, "nuscenes"))
            boxes.stamp_us.append(samples[token])
            boxes.pose.append(make_pose(row.key("translation").array(3), quaternion(row.key("rotation"))))
            boxes.size_m.append(np.array([length, width, height]))
            boxes.score.append(row.key(f"{task}_score").number())
    return boxes
