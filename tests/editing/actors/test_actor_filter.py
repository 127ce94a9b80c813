"""The filter and the order of the actor list, and when actors are present."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from list_entries import entry

from unisim_blender.editing.actors.table import (
    ActorFilter,
    chosen_entries,
    class_and_size,
    dense,
    distance_text,
    natural,
    nearest_present,
    speed_text,
    steps_of,
    time_text,
)
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.source import DriveSource


def test_filters_and_orders() -> None:
    known = [
        entry("Car 10", distance_m=5.0), entry("Car 2, white", distance_m=50.0, edited=True),
        entry("Cone 1", group="OTHER", label="Cones", distance_m=1.0, steps=np.array([[1.0, 2.0]])),
        entry("Pedestrian 1", group="PERSON", label="Pedestrian", there=False, distance_m=3.0,
        steps=np.array([[0.5, 0.6]])),
        entry("Never", there=False, steps=np.zeros((0, 2))),
    ]  # fmt: skip

    def names(**wanted: Any) -> list[str]:
        return [one.name for one in chosen_entries(known, ActorFilter(**wanted))]

    assert names() == ["Car 2, white", "Car 10", "Cone 1", "Never", "Pedestrian 1"]
    assert names(order="DISTANCE") == ["Cone 1", "Car 10", "Car 2, white", "Pedestrian 1", "Never"]
    assert names(order="TIME") == ["Car 2, white", "Car 10", "Pedestrian 1", "Cone 1", "Never"]
    assert (
        names(text="cone") == ["Cone 1"]
        and names(text="CONES") == ["Cone 1"]
        and names(text="white") == ["Car 2, white"]
    )
    assert names(group="PERSON") == ["Pedestrian 1"] and names(edited=True) == ["Car 2, white"]
    assert names(now=True) == ["Car 2, white", "Car 10", "Cone 1"] and names(within_m=6.0) == ["Car 10", "Cone 1"]
    assert sorted(["Car 10", "Car 9", "Bus 1"], key=natural) == ["Bus 1", "Car 9", "Car 10"]
    assert (
        nearest_present(known[2], 0.2) == 1.0
        and nearest_present(known[2], 1.5) == 1.5
        and nearest_present(known[4], 0.0) is None
    )


def test_steps_are_the_seconds_of_each_time_that_it_comes() -> None:
    clock = Clock(np.arange(6.0), np.arange(6) * 0.1)
    steps = steps_of(np.array([True, False, True, True, False, True]), clock)
    assert np.allclose(steps, [[0.0, 0.0], [0.2, 0.3], [0.5, 0.5]]) and not len(steps_of(np.zeros(6, bool), clock))


def test_words_of_a_row() -> None:
    one = entry("Car 1", distance_m=12.4, speed_m_s=10.0, steps=np.array([[0.0, 0.5], [2.0, 7.94]]))
    assert (distance_text(one), speed_text(one), time_text(one)) == ("12", "36", "0–7.9")
    gone = entry("Car 2", there=False, steps=np.zeros((0, 2)))
    assert (distance_text(gone), speed_text(gone), time_text(gone)) == ("–", "–", "never")


def test_ranks_without_gaps_keep_their_order() -> None:
    assert dense([0, 2, 5, 3]) == [0, 1, 3, 2] and dense([]) == []


def test_an_actor_is_told_by_class_and_size(source: DriveSource) -> None:
    actor = replace(next(iter(source.drive.actors.values())), label="Car", size_m=np.array([4.51, 1.84, 1.5]))
    assert class_and_size(actor) == "Car, 4.5 x 1.8 x 1.5 m"
