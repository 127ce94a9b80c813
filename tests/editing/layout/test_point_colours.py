"""Colours of LiDAR points and their legend."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from unisim_blender.editing.layout.point_colours import (
    DIVERGING,
    FAINT,
    GREY,
    SWEEP_COLOURS,
    TURBO,
    VIRIDIS,
    coloured,
    legend_shapes,
    point_colour,
    scale_ends,
)
from unisim_blender.editing.sensors.sweeps import DROPS, RECORDED, SIMULATED, ViewedSweep


def sweep(kind: str, **values: object) -> ViewedSweep:
    """Points with some attributes."""
    attributes = {name: np.asarray(value) for name, value in values.items()}
    return ViewedSweep("lidar", kind, np.zeros((len(next(iter(attributes.values()))), 3)), attributes)


def rgb(colours: NDArray[np.float32]) -> list[list[float]]:
    """Colours without opacity, as lists."""
    assert (colours[:, 3] == 1).all()
    return [[round(value, 5) for value in row] for row in colours[:, :3].tolist()]


def test_a_scale_has_round_ends_about_most_values() -> None:
    values = np.concatenate([np.linspace(5.6, 88.0, 1000), [0.1, 400.0]])
    assert scale_ends(values, "DEPTH") == (0.0, 100.0)
    assert scale_ends(np.linspace(0.001, 0.18, 100), "INTENSITY") == (0.0, 0.2)
    assert scale_ends(np.array([3.0, 3.0]), "DEPTH")[0] < scale_ends(np.array([3.0, 3.0]), "DEPTH")[1]
    assert scale_ends(np.array([0.0, 63.0, 5.0]), "RING") == (0.0, 63.0)
    assert scale_ends(np.concatenate([np.linspace(-0.3, 0.3, 100), [9.0] * 5]), "DIFFERENCE") == (-0.5, 0.5)
    assert scale_ends(np.zeros(0), "DEPTH") == (0.0, 1.0) and scale_ends(np.zeros(0), "DIFFERENCE") == (-1.0, 1.0)


def test_one_scale_holds_for_recorded_and_simulated_points() -> None:
    sweeps = [sweep(RECORDED, depth=[0.0, 50.0, np.nan]), sweep(SIMULATED, depth=[100.0, 50.0])]
    (recorded, simulated), legend = coloured(sweeps, "DEPTH")
    assert legend.bar == (TURBO, 0.0, 100.0)
    middle = [round(value, 5) for value in np.mean([TURBO[4], TURBO[5]], 0).tolist()]
    assert rgb(recorded) == [list(TURBO[0]), pytest.approx(middle, abs=1e-5), list(GREY)]
    assert rgb(simulated) == [pytest.approx(list(TURBO[-1]), abs=1e-5), pytest.approx(middle, abs=1e-5)]
    ring = coloured([sweep(RECORDED, ring=[0, 4, 2, -1])], "RING")[0][0]
    assert rgb(ring)[:3] == [pytest.approx(list(VIRIDIS[step]), abs=1e-5) for step in (0, 4, 2)]
    assert rgb(ring)[3] == list(GREY)


def test_differences_are_white_at_none_and_beams_of_one_sweep_have_its_colour() -> None:
    cells = {"cell": [0, 1, 2, 3, -1], "depth": [10.0, 10.5, 9.5, 30.0, 7.0], "intensity": np.ones(5)}
    sweeps = [
        sweep(RECORDED, **cells),
        sweep(DROPS[RECORDED], cell=[4, 5]),
        sweep(SIMULATED, cell=[2, 1, 0, 4], depth=[10.0, 10.0, 10.0, 8.0], intensity=np.ones(4)),
        sweep(DROPS[SIMULATED], cell=[3, 5]),
    ]
    (recorded, drops, simulated, simulated_drops), legend = coloured(sweeps, "DIFFERENCE")
    assert legend.bar == (DIVERGING, -0.5, 0.5)
    blue, white, red = (pytest.approx(list(DIVERGING[step]), abs=1e-5) for step in (0, 2, 4))
    only_recorded, only_simulated = (pytest.approx(list(SWEEP_COLOURS[kind])) for kind in (RECORDED, SIMULATED))
    assert rgb(recorded) == [white, red, blue, only_recorded, list(GREY)]
    assert rgb(simulated) == [blue, red, white, only_simulated]
    assert [str(text) for _, text in legend.entries] == ["Only recorded: 1", "Only simulated: 1", "not compared"]
    assert drops[0] == pytest.approx([*SWEEP_COLOURS[RECORDED], 1.0]) and drops[1] == pytest.approx([*GREY, FAINT])
    assert simulated_drops[0] == pytest.approx([*SWEEP_COLOURS[SIMULATED], 1.0])
    assert legend.lines[-2] == "Median range error 0.500 m, drops agree in 66.7 % of the beams"
    (alone,), _ = coloured([sweep(DROPS[SIMULATED], cell=[0])], "ONE")
    assert alone[0] == pytest.approx([*SWEEP_COLOURS[SIMULATED], FAINT])


def test_an_actor_has_one_colour_in_both_sweeps_and_the_legend_names_its_class() -> None:
    values = {"class": np.array([1, 1, 0, 2]), "instance": np.array([5, 9, 0, 8])}
    one = ViewedSweep("lidar", RECORDED, np.zeros((4, 3)), values, ("Car", "Pedestrian"))
    other = ViewedSweep(
        "lidar", SIMULATED, np.zeros((1, 3)), {"class": np.array([1]), "instance": np.array([5])}, ("Car",)
    )
    (recorded, simulated), legend = coloured([one, other], "INSTANCE")
    assert rgb(recorded)[0] == rgb(simulated)[0] == pytest.approx(list(point_colour("Car")), abs=1e-4)
    assert rgb(recorded)[1] != rgb(recorded)[0] and rgb(recorded)[2] == list(GREY)
    assert [str(text) for _, text in legend.entries] == ["Car: 2", "Pedestrian: 1", "no actor"]


def test_a_legend_lies_within_its_size() -> None:
    for by in ("ONE", "INTENSITY", "DEPTH", "RING", "INSTANCE", "DIFFERENCE"):
        _, legend = coloured([sweep(RECORDED, depth=[3.0, 60.0], intensity=[0.1, 0.2], ring=[0, 1])], by)
        shapes, width, height = legend_shapes(legend, lambda text: 6.0 * len(text))
        corners = np.array(shapes.corners)
        assert (corners >= -1e-6).all() and (corners <= [width + 1e-6, height + 1e-6]).all()
        assert all(0 <= x <= width - 6 * len(text) and 0 <= y <= height - 10 for text, x, y, _ in shapes.texts)
