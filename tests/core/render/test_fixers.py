"""Fixers: they draw anew what no recorded image shows, and nothing else."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from drive_frames import DriveFrames
from numpy.typing import NDArray
from rendered_folder import contents
from written_street import write_recipe

from unisim_blender.core.cli.main import unisim
from unisim_blender.core.data.log import Log
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.prepare.renderers import RENDERERS
from unisim_blender.core.render import recorded_depth as recorded_depth_module
from unisim_blender.core.render import traced_planes as traced_planes_module
from unisim_blender.core.render.fixers import FIXERS, ImageToFix, RecordedFixer, fixer_digest, fixer_named
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.traced_planes import plane_fill
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.sensors.frames import CameraFrame
from unisim_blender.core.world.drive import Drive
from unisim_blender.core.world.weather import Weather
from unisim_street.street import build_street
from unisim_street.truth import truth_camera

SAMPLE = Path(__file__).parents[3] / "sample" / "scene"
NEAREST = "examples.plugins.nearest_images:fix"
PASSES = ("rgb", "depth", "instance", "unsupported", "confidence")
FRAME, WIDTH = 4, 240
given: list[ImageToFix] = []


def pink(view: ImageToFix) -> Any:
    """Draw over everything, also over what it was given."""
    given.append(view)
    image = np.zeros(view.image.shape)
    image[:] = [1, 0, 1]
    view.image[:], view.depth_m[:], view.instance[:] = 0, 0, 0
    return image


@pytest.fixture(scope="module", autouse=True)
def few_views(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("UNISIM_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.setattr(recorded_depth_module, "VIEWS_PER_SENSOR", 5)
        yield


class StreetImages:
    """The images of the sample's log, drawn as they are read."""

    street = build_street(seed=0, frames=20, width=480, height=270)

    @cache  # noqa: B019
    def image(self, camera: str, frame: int) -> NDArray[np.uint8]:
        rgb = truth_camera(self.street, self.street.drive, camera, frame).rgb
        return np.rint(rgb * 255).astype(np.uint8)


@pytest.fixture(scope="module")
def log() -> Any:
    return StreetImages()


@pytest.fixture(scope="module")
def gone(backend: CompiledBackend) -> Drive:
    """The sample without its parked cars."""
    drive = backend.observed[0].drive
    actors = {uid: a for uid, a in drive.actors.items() if a.label != "Car" or a.is_moving}
    return replace(drive, actors=actors)


def fixing(backend: CompiledBackend, log: Log, function: Callable[[ImageToFix], Any] | str) -> Renderer:
    name = function if isinstance(function, str) else f"{__name__}:{function.__name__}"
    return Renderer(backend, fixer=RecordedFixer(name, log, backend.observed[0].drive.cameras))


def of(frames: DriveFrames, passes: tuple[str, ...] = PASSES, region: Region | None = None) -> CameraFrame:
    return frames.camera("front_camera", FRAME, passes, WIDTH, region)


def test_only_what_no_image_shows_is_drawn_anew(backend: CompiledBackend, log: Log, gone: Drive) -> None:
    plain, drawn = DriveFrames(Renderer(backend), gone), DriveFrames(fixing(backend, log, pink), gone)
    before, after = of(plain), of(drawn)
    weight = given[-1].weight
    np.testing.assert_array_equal(before.rgb[weight == 0], after.rgb[weight == 0])
    expected = before.rgb + weight[..., None] * (np.array([1, 0, 1], np.float32) - before.rgb)
    np.testing.assert_allclose(after.rgb, expected, atol=1e-6)
    assert 0.02 < (weight > 0.5).mean() < 0.2 and set(np.unique((weight * 9).round(4)) % 1) == {0}
    for name in ("depth_m", "z_depth_m", "instance", "confidence"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
    assert before.unsupported is not None and after.unsupported is not None
    np.testing.assert_array_equal(after.unsupported, before.unsupported | (weight > 0.5))
    assert np.array_equal(given[-1].confidence, before.confidence)  # type: ignore[arg-type]
    # parked cars stood there: the ground below them is not seen, that beside them is
    assert weight[120:].mean() > 3 * weight[:60].mean()
    # only what was asked for is in the frame, and a part has the bits of the whole
    alone, part = of(drawn, ("rgb",)), of(drawn, PASSES, Region(20, 60, 200, 120))
    assert (alone.depth_m, alone.instance, alone.unsupported, alone.confidence) == (None,) * 4
    np.testing.assert_array_equal(alone.rgb, after.rgb)
    for name, values in part.arrays().items():
        np.testing.assert_array_equal(values, getattr(after, name)[60:120, 20:200])
    camera = drawn.sized("front_camera", WIDTH)
    state, time_s = drawn.state(camera, camera.time_s[FRAME]), camera.time_s[FRAME]
    (tile,) = drawn.renderer.progressive(state, camera, time_s, PASSES, coarse=(4,), band=20)
    np.testing.assert_array_equal(tile.frame.rgb, after.rgb)
    assert drawn.renderer.margin(state) > WIDTH and not drawn.renderer.alone(state, camera)
    np.testing.assert_array_equal(plain.lidar("pandar64", FRAME).depth_m, drawn.lidar("pandar64", FRAME).depth_m)


def test_a_fixer_starts_from_filled_ground(backend: CompiledBackend, log: Log, gone: Drive) -> None:
    drive = backend.observed[0].drive
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(traced_planes_module, "TEXEL_M", 0.4)
        ground = plane_fill(backend)
    fixer = RecordedFixer(f"{__name__}:pink", log, drive.cameras)
    both = DriveFrames(Renderer(backend, fill=ground, fixer=fixer), gone)
    after, before = of(both), of(DriveFrames(Renderer(backend, fill=ground), gone))
    weight = given[-1].weight
    unfilled = of(DriveFrames(Renderer(backend), gone)).rgb
    changed = (before.rgb != unfilled).any(-1)
    assert (changed & (weight > 0)).sum() > 100
    np.testing.assert_array_equal(given[-1].filled[changed] > 0, True)
    assert not given[-1].filled[~changed].max() > 0.1 and given[-1].filled.max() <= 1
    expected = before.rgb + weight[..., None] * (np.array([1, 0, 1], np.float32) - before.rgb)
    np.testing.assert_allclose(after.rgb, expected, atol=1e-6)


def test_weather_lies_over_what_was_drawn(backend: CompiledBackend, log: Log, gone: Drive) -> None:
    foggy = [DriveFrames(each, gone) for each in (Renderer(backend), fixing(backend, log, pink))]
    camera = foggy[0].sized("front_camera", WIDTH)
    time_s = camera.time_s[FRAME]
    state = replace(foggy[0].state(camera, time_s), weather=Weather(visibility_m=30.0))
    before, after = (each.renderer.render(state, camera, time_s, ("rgb",)) for each in foggy)
    weight = given[-1].weight
    assert after.depth_m is None and (before.rgb[weight == 0] == after.rgb[weight == 0]).all()
    away = of(foggy[0]).depth_m
    assert away is not None
    depth, changed = away[weight > 0.9], abs(after.rgb - before.rgb).mean(-1)[weight > 0.9]
    near, far = (changed[part].mean() for part in (depth < np.median(depth), depth > np.median(depth)))
    assert near > 2 * far > 0


def test_references_are_the_closest_recorded_images(backend: CompiledBackend, log: Log, gone: Drive) -> None:
    of(DriveFrames(fixing(backend, log, pink), gone))
    view = given[-1]
    first, second = view.references
    image = log.image("front_camera", FRAME).astype(np.float32) / 255
    np.testing.assert_array_equal(first.image, image)
    np.testing.assert_allclose(first.world_from_camera, view.world_from_camera)
    assert first.model.width == 480 and not np.allclose(second.world_from_camera, view.world_from_camera)
    # from where it was recorded, an image is itself, but where what no image shows begins
    small = image.reshape(135, 2, 240, 2, 3).mean((1, 3))
    assert first.shown.mean() > 0.6 and abs(first.warped - small)[first.shown].mean() < 0.02
    assert second.shown.mean() > 0.3 and 0 < abs(second.warped - small)[second.shown].mean() < 0.06
    assert not (first.shown & (view.weight > 0)).any() and not first.warped[~first.shown].any()


def test_the_example_brings_images_nearer_to_the_truth(backend: CompiledBackend, log: Log, gone: Drive) -> None:
    drawn = of(DriveFrames(fixing(backend, log, NEAREST), gone))
    assert 0.02 < (drawn.rgb != of(DriveFrames(Renderer(backend), gone)).rgb).any(-1).mean() < 0.2


def test_nothing_is_asked_of_a_fixer_where_images_show_all(backend: CompiledBackend, log: Log) -> None:
    renderer, count = fixing(backend, log, pink), len(given)
    drive = backend.observed[0].drive
    frames = DriveFrames(renderer, drive)
    plain = DriveFrames(Renderer(backend), drive)
    region = Region(100, 60, 140, 70)
    before, after = of(plain, ("rgb",), region), of(frames, ("rgb",), region)
    np.testing.assert_array_equal(before.rgb, after.rgb)
    assert len(given) <= count + 1


def too_small(view: ImageToFix) -> Any:
    return view.image[1:]


def words(view: ImageToFix) -> Any:
    return np.full(view.image.shape, "red")


def nothing(view: ImageToFix) -> Any:
    return None


def not_a_number(view: ImageToFix) -> Any:
    return np.where(view.weight[..., None] > 0, np.nan, view.image)


def failing(view: ImageToFix) -> Any:
    raise ValueError("out of\nideas")


@pytest.mark.parametrize(
    ("function", "sentence"),
    [
        (
            too_small,
            r"must return numbers of shape \(135, 240, 3\), not an array of shape \(134, 240, 3\) and type float32",
        ),
        (words, "not an array of shape .* and type <U3"),
        (nothing, r"not an array of shape \(\) and type object"),
        (not_a_number, "returns numbers that are not finite"),
        (failing, r"ValueError: out of ideas \(test_fixers.py, line \d+\)"),
    ],
)
def test_errors_of_a_fixer_name_it(
    backend: CompiledBackend, log: Log, gone: Drive, function: Callable[[ImageToFix], Any], sentence: str
) -> None:
    with pytest.raises(UnisimError, match=f'^--fill "{re.escape(__name__)}:{function.__name__}": .*{sentence}$'):
        of(DriveFrames(fixing(backend, log, function), gone))


def test_another_packages_fixer_is_registered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "our_fixers.py").write_text(
        "class Grey:\n    name = 'grey'\n\n    def __call__(self, view):\n        return view.image\nGREY = Grey()\n"
    )
    about = tmp_path / "our_fixers-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: our-fixers\nVersion: 1\n")
    (about / "entry_points.txt").write_text(
        "[unisim_blender.fixers]\ngrey = our_fixers:GREY\nno = our_fixers:Grey.name\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    FIXERS.forget_plugins()
    try:
        with pytest.warns(UserWarning, match="the fixer 'no' of our-fixers is left out"):
            grey: Any = fixer_named("grey")
        assert grey.name == "grey" and fixer_named("texture") is None and fixer_digest("none") == {}
        before = fixer_digest("grey")
        (tmp_path / "our_fixers.py").write_text("# a line\n" + (tmp_path / "our_fixers.py").read_text())
        assert fixer_digest("grey") != before and len(before["fixer"]) == 64
        with pytest.raises(
            UnisimError, match='--fill "gray": must be one of none, texture.*, grey, or module:function'
        ):
            fixer_named("gray")
    finally:
        FIXERS.forget_plugins()


@pytest.mark.parametrize("fill", (NEAREST, "learned"))
def test_sequences_are_fixed_as_asked_and_say_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fill: str) -> None:
    monkeypatch.setattr(recorded_depth_module, "VIEWS_PER_SENSOR", 24)  # as in other processes
    log = write_recipe(tmp_path / "log", 60, frames=20, width=96, height=54, seed=0)
    scenario = tmp_path / "scenario.json"
    document = {
        "format": "unisim-scenario", "version": 1, "name": "gone", "log": str(log), "scene": str(SAMPLE),
        "frames": [4, 5], "edits": [{"type": "remove", "actor": f"car-{number:02}"} for number in (6, 7, 11, 12)],
        "outputs": {"fill": fill, "formats": ["png", "ply"], "passes": ["rgb", "unsupported"]},
    }  # fmt: skip
    scenario.write_text(json.dumps(document))

    def files(out: str, *more: str) -> dict[str, bytes]:
        arguments = ["render", str(scenario), "--out", str(tmp_path / out), "--width", "120", *more]
        result = CliRunner().invoke(unisim, arguments, catch_exceptions=False)
        assert result.exit_code == 0, result.output
        return contents(tmp_path / out)

    fixed, two = files("one", "--jobs", "1"), files("two", "--jobs", "2")
    plain, textured = (files(other, "--jobs", "1", "--fill", other) for other in ("none", "texture"))
    assert fixed == two
    manifest = json.loads(fixed["manifest.json"])
    assert manifest["settings"]["fill"] == fill and len(manifest["environment"]["fixer"]) == 64
    assert "fixer" not in json.loads(plain["manifest.json"])["environment"]
    for name in fixed:
        if name.startswith(("camera", "lidar")):
            assert fixed[name] != plain[name] and (fixed[name] == textured[name]) == name.startswith("lidar"), name
    for wrong, sentence in (("textur", "one of none, texture"), ("tests:no", "no")):
        refused = CliRunner().invoke(unisim, ["render", str(scenario), "--out", str(tmp_path / "no"), "--fill", wrong])
        assert refused.exit_code != 0 and not (tmp_path / "no").exists()
        assert f'--fill "{wrong}"' in str(refused.exception) and sentence in str(refused.exception)
    surfels = ["render", str(scenario), "--out", str(tmp_path / "no"), "--renderer", next(iter(RENDERERS))]
    assert CliRunner().invoke(unisim, surfels).exit_code != 0
