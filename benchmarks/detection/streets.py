"""Samples of exact streets: images and sweeps by the exact renderer, with the noise of a recorded sweep,
and nothing else.

The traffic of every street sets out from the same places. So that a detector cannot learn these by heart, the streets
to train on have it come earlier or later, and the recording vehicle further to the side, by amounts drawn from
the street's seed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from unisim_blender.core.formats.pandaset.sensors import PANDAR64
from unisim_blender.core.scenario import apply_scenario
from unisim_blender.core.scenario.edit import Edit
from unisim_blender.core.scenario.edits import Ego, Retime
from unisim_blender.core.scenario.types import Scenario
from unisim_blender.core.world.drive import Actor, Drive
from unisim_street.street import Street, build_street
from unisim_street.truth import truth_camera, truth_lidar
from unisim_street.write import noisy

from .samples import Key, Sample, sample_of

CAMERA = "front_camera"
EARLIER_S = 0.9
"""Traffic comes at most so much earlier or later: no two vehicles of one lane meet."""
LEFT_M = (-0.5, 2.0)


@dataclass(frozen=True)
class StreetSet:
    """Which streets and frames: ``seeds``, streets of ``length`` frames, of which each ``step``-th is taken.
    ``varied``: with traffic and vehicle elsewhere; ``left_m``: the vehicle so far to the left."""

    seeds: tuple[int, ...]
    length: int
    step: int
    varied: bool
    left_m: float = 0.0
    width: int = 320
    height: int = 180

    @property
    def keys(self) -> list[Key]:
        """The frames, by street."""
        return [Key(f"street-{seed}", frame) for seed in self.seeds for frame in range(0, self.length, self.step)]

    def street(self, seed: int) -> Street:
        """The street of a seed as it is recorded."""
        return build_street(seed, self.length, self.width, self.height)

    def edited(self, street: Street, recorded: Drive) -> Drive:
        """What samples are taken of: a drive recorded on that street, with the set's edits."""
        edits = varied(street.drive, street.recipe.seed) if self.varied else ()
        if self.left_m:
            edits = (*edits, Ego(shift_left_m=self.left_m))
        return apply_scenario(Scenario(name=recorded.name, log="street", edits=edits), recorded, _no_scene)

    def sample(self, key: Key) -> Sample:
        """Render one."""
        street, drive = _street(self, seed_of(key))
        sweep = noisy(truth_lidar(street, drive, PANDAR64, key.frame), street, key.frame)
        return sample_of(drive, key.frame, CAMERA, truth_camera(street, drive, CAMERA, key.frame).rgb, sweep)


def seed_of(key: Key) -> int:
    """Of which street a sample is."""
    return int(key.sequence.rpartition("-")[2])


@lru_cache(maxsize=1)  # frames come street by street
def _street(streets: StreetSet, seed: int) -> tuple[Street, Drive]:
    street = streets.street(seed)
    return street, streets.edited(street, street.drive)


def varied(drive: Drive, seed: int) -> tuple[Edit, ...]:
    """Edits that let every moving actor come earlier or later, and the vehicle drive further to the side."""
    rng = np.random.default_rng([seed, 2018])
    moving = [actor.uid for actor in drive.actors.values() if actor.is_moving]
    shift = Ego(shift_left_m=float(rng.uniform(*LEFT_M)))
    return (
        *(Retime(actor=uid, offset_s=float(rng.uniform(-EARLIER_S, EARLIER_S)), outside="continue") for uid in moving),
        shift,
    )


def _no_scene(path: object) -> dict[str, Actor]:
    raise AssertionError(f"no actor of another scene was asked for: {path}")
