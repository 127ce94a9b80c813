"""The street's truth behind the interface that every renderer of frames has."""

from __future__ import annotations

from dataclasses import dataclass

from ..drive import Drive
from ..frames import CameraFrame, LidarFrame
from .street import Street
from .truth import truth_camera, truth_lidar

_FIELDS_OF_PASS = {
    "depth": ("depth_m", "z_depth_m"),
    "normal": ("normal",),
    "instance": ("instance",),
    "opacity": ("opacity",),
}


@dataclass(frozen=True)
class StreetRenderer:
    """Renders a drive, recorded or edited, of a street; ``samples`` squared rays a pixel. A street supports every pixel."""

    street: Street
    drive: Drive
    samples: int = 2

    def camera(self, camera_id: str, frame: int, passes: tuple[str, ...] = ("rgb",), width: int | None = None) -> CameraFrame:
        """One image with the passes asked for."""
        full = truth_camera(self.street, self.drive, camera_id, frame, width, self.samples)
        for name, fields in _FIELDS_OF_PASS.items():
            if name not in passes:
                for field in fields:
                    setattr(full, field, None)
        return full

    def lidar(self, lidar_id: str, frame: int) -> LidarFrame:
        """One sweep."""
        return truth_lidar(self.street, self.drive, lidar_id, frame)
