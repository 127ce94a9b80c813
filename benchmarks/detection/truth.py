"""The samples of what a scenario's sensors truly see of its street, whoever draws that street's images."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

from unisim_blender.core.formats.pandaset.sensors import PANDAR64
from unisim_blender.core.prepare.scenario import prepare_scenario
from unisim_blender.core.prepare.scenario_plan import scenario_hash
from unisim_blender.core.prepare.selection import check_names, select_frames
from unisim_street.street_truth import KnownStreets, StreetTruth
from unisim_street.truth import truth_lidar
from unisim_street.write import noisy

from .samples import Key, Sample, sample_of
from .streets import CAMERA


class TrueSet:
    """``frames`` ("START:STOP:STEP", all where None) of the scenario at a path; those that a path tracer has to draw
    are drawn once, into the street's folder. Raises `UnisimError`."""

    def __init__(self, scenario: Path, frames: str | None) -> None:
        self._scenario, self._prepared = scenario, prepare_scenario(scenario, refined=False)
        drive = self._prepared.edited
        check_names("camera", (CAMERA,), drive.cameras)
        check_names("LiDAR", (PANDAR64,), drive.lidars)
        self._frames = select_frames(frames, drive.frames)
        self.keys = [Key(drive.name, frame) for frame in self._frames]
        self.about = {"scenario": scenario_hash(self._prepared.scenario), "frames": self._frames}

    def sample(self, key: Key) -> Sample:
        """Of one frame, with the noise of a recorded sweep."""
        street, drive = self._true.street, self._true.edited
        sweep = noisy(truth_lidar(street, drive, PANDAR64, key.frame), street, key.frame)
        return sample_of(drive, key.frame, CAMERA, self._true.image("edit", CAMERA, key.frame), sweep)

    @cached_property  # a set that is whole, or another's, has nothing drawn
    def _true(self) -> StreetTruth:
        true = KnownStreets.open(self._prepared.scenario.log_path).truth(self._prepared, (), (), None)
        true.draw(self._scenario, self._frames, (CAMERA,))
        return true
