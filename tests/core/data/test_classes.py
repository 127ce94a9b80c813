"""Classes of each dataset: how their actors move."""

from __future__ import annotations

import pytest

from unisim_blender.core.data.classes import PANDASET, TABLES, motion_of
from unisim_blender.core.ops.constants import VEHICLES


@pytest.mark.parametrize(
    ("label", "motion"),
    [
        ("Car", "rigid"), ("REGULAR_VEHICLE", "rigid"), ("vehicle.bus.rigid", "rigid"), ("TYPE_CYCLIST", "deforming"),
        ("human.pedestrian.adult", "deforming"), ("movable_object.trafficcone", "still"), ("CONSTRUCTION_CONE", "still"),
        ("MESSAGE_BOARD_TRAILER", "still"), ("Person_sitting", "deforming"), ("", None), ("Spaceship", None), ("car", None),
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
    mirrored = [name for name in PANDASET if any(word in name.lower() for word in VEHICLES)]
    assert len(mirrored) > 9 and {PANDASET[name] for name in mirrored} == {"rigid"}
