"""The samples of what a scenario's sensors truly see of its street, whoever draws that street's images."""

from __future__ import annotations

from pathlib import Path

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.evaluate.true_edits import TrueEdit
from unisim_blender.core.logs.pandaset_sensors import PANDAR64
from unisim_blender.core.prepare.scenario import prepare_scenario
from unisim_blender.core.prepare.scenario_plan import scenario_hash
from unisim_blender.core.prepare.selection import select_frames
from unisim_blender.core.street.write import noisy

from .samples import Key, Sample, sample_of
from .streets import CAMERA


class TrueSet:
    """``frames`` ("START:STOP:STEP", all where None) of the scenario at a path; those that a path tracer has to draw are drawn
    once, into the street's folder. Raises `UnisimError`."""

    def __init__(self, scenario: Path, frames: str | None) -> None:
        prepared = prepare_scenario(scenario, refined=False)
        drive = prepared.edited
        chosen = drive.frames if frames is None else select_frames(frames, drive.frames)
        self.keys = [Key(drive.name, frame) for frame in chosen]
        self.about = {"scenario": scenario_hash(prepared.scenario), "frames": chosen}
        self._true = TrueEdit.on(prepared.scenario.log_path, prepared, (), (), None)
        self._true.draw(scenario, chosen, (CAMERA,))

    def sample(self, key: Key) -> Sample:
        """Of one frame, with the noise of a recorded sweep."""
        true = self._true
        sweep = true.sweep("edit", PANDAR64, key.frame)
        if sweep is None:
            raise ScenarioError(f"{true.edited.name}: has no LiDAR {PANDAR64!r}")
        picture = true.picture("edit", CAMERA, key.frame)
        return sample_of(true.edited, key.frame, CAMERA, picture, noisy(sweep, true.street, key.frame))
