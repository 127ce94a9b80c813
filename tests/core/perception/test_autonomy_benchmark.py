"""The benchmark of the stack on recorded, replayed and shifted sensors: what is delivered; tables against hand-worked cases."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[3]))

from written_street import write_street

from benchmarks.autonomy.__main__ import rows_of
from benchmarks.autonomy.comparison import beside_others, beside_truth, lines
from unisim_blender.core.evaluation.autonomy.document import Forecast, FrameKey, FrameOutput, ModelOutputs
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import transform_points
from unisim_blender.core.prepare.scenario_plan import RenderOptions
from unisim_street.street import build_street, recipe_document

CAMERA, LIDAR = "front_camera", "pandar64"


def outputs(end_m: tuple[float, float], scored: bool = True, y_m: float = 0.0) -> ModelOutputs:
    """Two frames with a vehicle that goes on at 1 m a position, and plans that end so far ahead."""
    frames: dict[FrameKey, FrameOutput] = {}
    for number, end in enumerate(end_m):
        positions = np.stack([10.0 + np.arange(3), np.full(3, y_m)], -1)
        frames[("drive", number)] = FrameOutput(
            np.array([[10.0, y_m, 4.0, 2.0, 0.0]]), np.array([0.9]), ("vehicle",), np.zeros(1, bool),
            (Forecast(positions[None], np.ones(1)),), np.stack([np.linspace(0, end, 3), np.zeros(3)], -1),
        )  # fmt: skip
    return ModelOutputs("bev", frames, scored)


def test_agreement_forecasts_and_ends_of_plans() -> None:
    labels, reference = outputs((40.0, 40.0), scored=False), outputs((40.0, 40.0))
    found = beside_others(outputs((40.5, 10.0), y_m=0.5), reference, labels)
    assert found["agreement"]["ap@0.3"]["value"] == 1.0 and found["forecasts"]["min_ade_m"] == pytest.approx(0.5)
    plans = found["plans"]
    assert plans["by_frame_m"] == [0.5, 30.0] and plans["end_point_error_m"] == 15.25 and plans["greatest_m"] == 30.0
    assert plans["near"] == 0.5 and tuple(plans["interval"]) == (0.5, 30.0)
    truth = beside_truth(reference, labels)
    assert "plans" not in truth
    shown = lines(
        {"recorded": {"truth": truth}, "replayed": {"truth": truth, "reference": "recorded", "others": found}}
    )
    assert shown[-1].endswith("| 15.25 (0.50 to 30.00) | 15.25 | 30.0 | 1 of 2 |")
    assert sum(line.startswith("| replayed |") for line in shown) == 2


@pytest.mark.perception
def test_of_a_street_shifted_sensors_have_exact_ones_beside_them(tmp_path: Path) -> None:
    log = write_street(tmp_path / "log", 3, columns=120)
    recipe = recipe_document(build_street(3, 3, 64, 36, (CAMERA,), 0.0).recipe)
    (log / "street.json").write_text(json.dumps(recipe))
    rows = rows_of(log, RenderOptions(renderer="street"), 2.0, tmp_path / "out")
    beside = {name: row.reference for name, row in rows.items()}
    assert beside == {
        "recorded": None, "replayed": "recorded", "exact": "recorded", "shifted 2 m, exact": None,
        "shifted 2 m": "shifted 2 m, exact",
    }  # fmt: skip
    recorded, shifted = rows["recorded"], rows["shifted 2 m, exact"]
    context = recorded.simulation.context
    assert {one.capture.frame for one in context.exposures} == {1, 2}  # the first frame's begin before it
    images, sweeps = recorded.sensors.render(context.drive, context.exposures)
    there = open_log(log)
    np.testing.assert_array_equal(images[0].rgb, there.image(CAMERA, 1))
    lidar = context.drive.lidars[LIDAR]
    points = transform_points(
        lidar.world_from_lidar.at(lidar.time_s[1]), np.stack([sweeps[0].points[a] for a in "xyz"], -1)
    )
    np.testing.assert_allclose(points, there.sweep(LIDAR, 1).points, atol=1e-4)
    moved = shifted.simulation.context.drive.world_from_ego.at(0.1) - context.drive.world_from_ego.at(0.1)
    assert np.hypot(*moved[:2, 3]) == pytest.approx(2.0)
    first = [one for one in shifted.simulation.context.exposures if one.capture.sensor_id == CAMERA][:1]
    (aside,), _ = shifted.sensors.render(shifted.simulation.context.drive, first)
    assert np.mean(np.any(aside.rgb != images[0].rgb, -1)) > 0.5
