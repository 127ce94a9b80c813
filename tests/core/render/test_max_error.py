"""Errors that a user bounds: what is asked, what samples say of it, and whether frames keep what was promised."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from analytic_scene import drive_of
from drive_frames import DriveFrames
from random_scene import CARS, CONFIGS, MOVING, saved
from scipy.stats import binom
from skimage.color import rgb2lab

from unisim_blender.core import native
from unisim_blender.core.colour import lab_from_srgb
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.model.scene_file import read_scene_header
from unisim_blender.core.render.bounded import BoundedRenderer, Patches, at_quality, colour_errors
from unisim_blender.core.render.quality import ERROR_BOUND_QUALITIES, TRUTH_QUALITY
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracers.torch.tracer import TorchBackend, TorchTracer
from unisim_blender.core.scenes.recipe import load_backend
from unisim_blender.core.scenes.scene import open_scene
from unisim_blender.core.sensors.error_bound import (
    ErrorBound,
    depth_errors,
    drawn,
    parse_bounds,
    quantile_check,
    quantile_rank,
)
from unisim_blender.core.sensors.frames import CameraFrame, LidarFrame, RenderStats
from unisim_blender.core.world.captures import Capture
from unisim_blender.core.world.drive import Drive

SAMPLE = Path(__file__).parents[3] / "sample" / "scene"
needs_library = pytest.mark.skipif(native.library() is None, reason="the compiled kernels were not built")


def test_bounds_are_read_as_they_are_written() -> None:
    bounds = parse_bounds(["1mm", "p90:20mm", "40dB", "1.5de", "40 db"])
    assert set(bounds) == {
        ErrorBound("mm", 1.0),
        ErrorBound("mm", 20.0, 0.9),
        ErrorBound("dB", 40.0),
        ErrorBound("dE", 1.5),
    }
    assert {str(bound) for bound in bounds} == {"1mm", "p90:20mm", "40dB", "1.5dE"}
    assert bounds == parse_bounds(["1.5dE", "40dB", "p90:20mm", "1mm"]), "their order changes nothing"
    fine = parse_bounds(["0.12345678901mm", "40.12345678dB", "p99.95:0.00000012mm"])
    assert parse_bounds([str(bound) for bound in fine]) == fine, "a bound is the same after it was written"
    assert ErrorBound("dB", 40.0).most == pytest.approx(1e-4) and ErrorBound("dB", 40.0).shown(1e-4) == pytest.approx(
        40
    )


@pytest.mark.parametrize("text", ("1", "mm", "1m", "-1mm", "0mm", "p90:40dB", "p0:1mm", "p100:1mm", "40dB,1mm"))
def test_a_bound_that_says_nothing_is_named(text: str) -> None:
    with pytest.raises(UnisimError, match=f'--max-error "{text}": must be a median depth error like 1mm'):
        parse_bounds([text])


def test_colours_in_lab_are_scikit_images() -> None:
    """But for its white point, which has five digits."""
    rgb = np.random.default_rng(0).random((1000, 3)).astype(np.float32)
    rgb[:8] = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    rgb[8:200] *= 0.02
    convert: Any = rgb2lab
    assert np.abs(lab_from_srgb(rgb) - convert(rgb.astype(np.float64))).max() < 0.01


def test_depths_that_one_alone_has_are_infinitely_wrong() -> None:
    errors = depth_errors(np.array([1, 0, 2, 0], np.float32), np.array([1.5, 3, 0, 0], np.float32))
    assert errors.tolist() == [500, np.inf, np.inf]


@pytest.mark.parametrize("quantile", (0.5, 0.9, 0.99))
@pytest.mark.parametrize("n", (1, 7, 512, 4096))
def test_the_rank_is_the_binomials(n: int, quantile: float) -> None:
    rank = quantile_rank(n, quantile)
    assert rank > n or binom.sf(rank - 1, n, quantile) <= 0.002
    assert binom.sf(rank - 2, n, quantile) > 0.002, "no smaller one would do"


def test_a_quantiles_bound_holds_whatever_the_errors_are() -> None:
    """Heavy tails, ties, and a fifth that is infinite."""
    rng = np.random.default_rng(0)
    everything = np.exp(rng.normal(0, 3, 20000))
    everything[:3000], everything[3000:7000] = 1.0, np.inf
    for quantile in (0.5, 0.75):
        true = np.quantile(everything, quantile, method="inverted_cdf")
        checks = [
            quantile_check(ErrorBound("mm", 1.0, quantile), rng.choice(everything, 256, False)) for _ in range(2000)
        ]
        assert np.mean([check.most < true for check in checks]) <= 0.005
        assert np.mean([check.estimate < true for check in checks]) > 0.3, "it is the margin that does it"
    assert quantile_check(ErrorBound("mm", 1.0, 0.9), everything[:20]).most == math.inf, "too few say nothing of a tail"
    assert quantile_check(ErrorBound("mm", 1.0), np.zeros(0)).holds


def test_units_are_drawn_in_proportion_and_all_over() -> None:
    rng = np.random.default_rng(0)
    weights = np.array([1.0, 0.0, 3.0, 2.0, 0.0])
    counts = np.bincount(drawn(weights, 6000, rng), minlength=5)
    assert counts.tolist() == [1000, 0, 3000, 2000, 0]
    assert np.diff(np.sort(drawn(np.ones(1000), 100, rng))).max() < 20


def narrowed(drive: Drive, columns: int) -> Drive:
    """A drive whose sweeps have so many columns."""
    lidars = {
        name: dataclasses.replace(lidar, model=dataclasses.replace(lidar.model, columns=columns), blocked=None)
        for name, lidar in drive.lidars.items()
        if lidar.model.beams
    }
    return dataclasses.replace(drive, lidars=lidars)


def whole(frame: CameraFrame | LidarFrame, truth: CameraFrame | LidarFrame, bound: ErrorBound) -> float:
    """A whole frame's error."""
    if isinstance(frame, LidarFrame) and isinstance(truth, LidarFrame):
        errors = depth_errors(frame.depth_m, truth.depth_m)
        return float(np.quantile(errors, bound.quantile, method="inverted_cdf"))
    assert isinstance(frame, CameraFrame) and isinstance(truth, CameraFrame)
    a, b = (np.clip(x.rgb.reshape(-1, 3), 0, 1).astype(np.float64) for x in (frame, truth))
    return float(colour_errors(a, b)[bound.unit].mean())


@pytest.fixture(scope="module")
def street() -> DriveFrames:
    header = read_scene_header(SAMPLE)
    drive = narrowed(header.drive, 45)
    return DriveFrames(Renderer(load_backend(open_scene(SAMPLE))), drive)


@needs_library
def test_the_samples_rays_have_the_frames_bits(street: DriveFrames) -> None:
    """Of a sweep's beams alone, and of an image's pixels alone: so a sample is rendered as its frame is."""
    rays, sweep = (
        street.sweep_rays(Capture.of_frame(street.lidar_named("pandar64"), 9))[1].flat(),
        street.lidar("pandar64", 9),
    )
    some = np.random.default_rng(0).choice(len(rays.time_s), 300, False)
    depth = street.rays_lidar(rays.origins[some], rays.directions[some], rays.time_s[some])[0]
    assert np.array_equal(depth, sweep.depth_m.reshape(-1)[some])
    patches = Patches(street.renderer, street.captures, "front_camera", 96)
    units = np.random.default_rng(1).choice(96 * 54, 300, False)
    image = street.camera("front_camera", 9, width=96)
    found = patches.rendered(Capture.of_frame(patches.camera, 9), units, ERROR_BOUND_QUALITIES["balanced"])
    assert np.array_equal(found, patches.shown(image.rgb, units))


@needs_library
def test_the_sample_street_keeps_what_it_promises(street: DriveFrames) -> None:
    """Every promise of a frame, held against the whole of it; what all settings keep is kept by the cheapest, and what
    none can keep is said not to be."""
    with at_quality(street.renderer, TRUTH_QUALITY):
        truths = street.camera("front_camera", 13, width=64), street.lidar("pandar64", 13)
    bounded = BoundedRenderer(street.renderer, street.captures, ())
    used = {}
    for bound in parse_bounds(["20dB", "38dB", "90dB", "0.5dE", "500mm", "0.1mm", "p75:3mm", "0.00001mm"]):
        of_depth = bound.unit == "mm"
        bounded.of_depth, bounded.of_colour = ((bound,), ()) if of_depth else ((), (bound,))
        sensor = street.lidar_named("pandar64") if of_depth else street.sized("front_camera", None)
        found = bounded.render(Capture.of_frame(sensor, 13), width=64)
        assert found.error_bound is not None
        assert found.error_bound.holds == (str(bound) not in ("90dB", "0.00001mm")), (bound, found.error_bound)
        assert not found.error_bound.holds or whole(found, truths[of_depth], bound) <= bound.most, (
            bound,
            found.error_bound,
        )
        used[str(bound)] = found.error_bound.settings
    assert used["20dB"] == used["500mm"] == "fast"
    assert "fast" not in (used["38dB"], used["0.1mm"])
    assert used["90dB"] == used["0.00001mm"] == list(ERROR_BOUND_QUALITIES)[-1]


@pytest.mark.parametrize("seed", range(3))
def test_scenes_of_random_weights_keep_what_they_promise(seed: int, tmp_path: Path) -> None:
    """Their decoder looks aside, so images are judged by patches."""
    scene = saved(tmp_path / "scene", CONFIGS["tiny"], seed)
    drive = drive_of([*CARS, MOVING])
    renderer = DriveFrames(Renderer(load_backend(open_scene(scene))), drive)
    camera = drive.cameras["front"]
    assert not renderer.renderer.alone(renderer.state(camera, camera.time_s[2]), camera)
    kept = 0
    with at_quality(renderer.renderer, TRUTH_QUALITY):
        truths = renderer.camera("front", 2), renderer.lidar("top", 2)
    for bound in parse_bounds(["30dB", "3dE", "5mm", "100mm"]):
        bounded = BoundedRenderer(renderer.renderer, renderer.captures, [bound], seed=seed)
        of_depth = bound.unit == "mm"
        found = bounded.render(Capture.of_frame(drive.lidars["top"] if of_depth else camera, 2))
        assert found.error_bound is not None
        if found.error_bound.holds:
            kept += 1
            assert whole(found, truths[of_depth], bound) <= bound.most, (bound, found.error_bound)
        else:
            assert found.error_bound.settings == list(ERROR_BOUND_QUALITIES)[-1]
    assert kept, "a test of promises needs some"


def test_sensors_without_a_bound_are_rendered_as_ever(street: DriveFrames) -> None:
    bounded = BoundedRenderer(street.renderer, street.captures, parse_bounds(["40dB"]))
    sweep = bounded.sweep(Capture.of_frame(street.lidar_named("pandar64"), 3))
    assert sweep.error_bound is None
    assert np.array_equal(sweep.depth_m, street.lidar("pandar64", 3).depth_m)


def test_torchs_truth_is_in_single_precision_and_samples_what_is_far(tmp_path: Path) -> None:
    drive = drive_of(CARS)
    renderer = DriveFrames(Renderer(TorchBackend(load_scene(saved(tmp_path / "scene", CONFIGS["tiny"])))), drive)
    lidar, rays = renderer.sweep_rays(Capture.of_frame(renderer.lidar_named("top"), 2))
    state = renderer.state(lidar, lidar.time_s[2])

    def tracer() -> TorchTracer:
        found = renderer.renderer.tracer(state)
        assert isinstance(found, TorchTracer)
        return found

    counts = {}
    for name, quality in (
        ("balanced", ERROR_BOUND_QUALITIES["balanced"]),
        ("truth", TRUTH_QUALITY),
        ("near", dataclasses.replace(TRUTH_QUALITY, background=1.0)),
    ):
        stats = RenderStats()
        with at_quality(renderer.renderer, quality):
            tracer().trace(rays, set(), True, None, stats)
        counts[name] = stats.samples_spent
    assert counts["truth"] > counts["near"] > counts["balanced"], "samples beyond the volume follow the quality"
    # a device that decodes in half precision may only where nothing is held against it
    tracer().device = torch.device("cuda")
    assert tracer().half
    with at_quality(renderer.renderer, TRUTH_QUALITY):
        assert not tracer().half
    with at_quality(renderer.renderer, ERROR_BOUND_QUALITIES["8 times the samples"]):
        assert not tracer().half
    assert tracer().half
