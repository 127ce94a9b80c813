"""Classes of each dataset: how their actors move."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tiny_drive import TinyLog

from unisim_blender.core.data.log import LogExtras, extras_of
from unisim_blender.core.ops.constants import SYMMETRIC_CLASSES
from unisim_blender.core.world.classes import PANDASET, TABLES, motion_of


@pytest.mark.parametrize(
    ("label", "motion"),
    [
        ("Car", "rigid"), ("REGULAR_VEHICLE", "rigid"), ("vehicle.bus.rigid", "rigid"), ("TYPE_CYCLIST", "deforming"),
        ("human.pedestrian.adult", "deforming"), ("movable_object.trafficcone", "still"), ("CONSTRUCTION_CONE", "still"),
        ("MESSAGE_BOARD_TRAILER", "still"), ("Person_sitting", "deforming"), ("Person", "deforming"),
        ("", None), ("Spaceship", None), ("car", None),
    ],
)  # fmt: skip
def test_names_of_the_datasets(label: str, motion: str | None) -> None:
    assert motion_of(label) == motion


def test_a_logs_own_names_come_first() -> None:
    assert (
        motion_of("Cones", {"Cones": "rigid"}) == "rigid"
        and motion_of("robot.arm", {"robot": "deforming"}) == "deforming"
    )


def test_tables_do_not_contradict_each_other() -> None:
    for a in TABLES:
        for b in TABLES:
            assert all(a[name] == b[name] for name in a.keys() & b.keys())


def test_of_pandaset_what_is_mirrored_is_rigid() -> None:
    """So that scenes of its logs are trained as before there was a table."""
    mirrored = [name for name in PANDASET if any(word in name.lower() for word in SYMMETRIC_CLASSES)]
    rigid = {name for name in mirrored if PANDASET[name] == "rigid"}
    assert len(mirrored) > 9 and set(mirrored) - rigid == {
        "Bicycle"
    }  # its rider's legs are not each other's mirror images


def test_optional_members_of_a_log_have_defaults() -> None:
    class Rich(TinyLog):
        classes: Any = {"robot": "deforming"}

        def own_vehicle_mask(self, camera: str) -> NDArray[np.bool_]:
            return np.full((1, 2), camera == "front")

    plain, rich = extras_of(TinyLog()), extras_of(Rich())
    assert plain == LogExtras() and plain.classes == {} and plain.own_vehicle_mask("front") is None
    assert rich.classes == {"robot": "deforming"}
    mask = rich.own_vehicle_mask("front")
    assert mask is not None and mask.all()
    Rich.classes = None
    assert extras_of(Rich()).classes == {}
