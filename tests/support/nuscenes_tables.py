"""Writes nuScenes' v1.0 tables of one scene, as the dataset's own are: rows in JSON files that name each other by tokens."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass
class Tables:
    """Rows by table. Poses are places and rotations w x y z; stamps are whole microseconds."""

    scene: str = "scene-0001"
    rows: dict[str, list[dict[str, Any]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.scene_token = self._add("scene", name=self.scene, description="", log_token=self.token("log"))
        for table in ("sample", "sample_data", "ego_pose", "calibrated_sensor", "sensor", "sample_annotation"):
            self.rows.setdefault(table, [])
        for table in ("instance", "category"):
            self.rows.setdefault(table, [])

    def token(self, table: str) -> str:
        """A new token."""
        return f"{table.encode().hex()[:12]:0<12}{len(self.rows.get(table, [])):020x}"

    def _add(self, table: str, **row: Any) -> str:
        token = self.token(table)
        self.rows.setdefault(table, []).append({"token": token, **row})
        return token

    def sensor(
        self, channel: str, place: list[float], rotation: list[float], intrinsics: list[list[float]] | None = None
    ) -> str:
        """A sensor and its calibration; gives the calibration's token."""
        modality = "lidar" if intrinsics is None else "camera"
        token = self._add("sensor", channel=channel, modality=modality)
        about = {"translation": place, "rotation": rotation, "camera_intrinsic": intrinsics or []}
        return self._add("calibrated_sensor", sensor_token=token, **about)

    def sample(self, stamp_us: int) -> str:
        """A key frame."""
        return self._add("sample", timestamp=stamp_us, scene_token=self.scene_token, prev="", next="")

    def capture(
        self,
        sample: str,
        sensor: str,
        stamp_us: int,
        file: str,
        pose: tuple[list[float], list[float]],
        key: bool,
        size: tuple[int, int] = (0, 0),
    ) -> str:
        """An image or a sweep, and where the vehicle was then."""
        place, rotation = pose
        ego = self._add("ego_pose", timestamp=stamp_us, translation=place, rotation=rotation)
        about = {"fileformat": "pcd", "is_key_frame": key, "width": size[0], "height": size[1], "filename": file}
        tokens = {"sample_token": sample, "ego_pose_token": ego, "calibrated_sensor_token": sensor}
        return self._add("sample_data", **tokens, timestamp=stamp_us, **about, prev="", next="")

    def category(self, name: str) -> str:
        """A class."""
        known = {row["name"]: row["token"] for row in self.rows["category"]}
        return known.get(name) or self._add("category", name=name, description="")

    def instance(self, category: str) -> str:
        """An object of a class; gives its token."""
        return self._add("instance", category_token=self.category(category), nbr_annotations=0)

    def box(self, sample: str, instance: str, place: list[float], rotation: list[float], size: list[float]) -> None:
        """An object's box in a key frame; size: width, length, height."""
        about = {"translation": place, "rotation": rotation, "size": size, "num_lidar_pts": 1}
        self._add("sample_annotation", sample_token=sample, instance_token=instance, **about, attribute_tokens=[])

    def write(self, folder: Path) -> None:
        """Write all tables."""
        folder.mkdir(parents=True, exist_ok=True)
        for table, rows in self.rows.items():
            (folder / f"{table}.json").write_text(json.dumps(rows, indent=0))
