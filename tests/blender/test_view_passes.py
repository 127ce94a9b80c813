"""The worker's answers for a view: unsupported pixels in coarse images, bands and parts; views clipped to
what was observed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.core.worker.server import Jobs
from unisim_blender.core.world.drive import CameraModel
from unisim_blender.editing.reading.requests import camera_request
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.scene import SampledObject, optical

SIZE = (160, 100)
FRAME = 9.0


@pytest.fixture
def jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Jobs:
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    return Jobs(tmp_path)


@pytest.fixture
def above(street: Any) -> dict[str, Any]:
    """The request of a free view that looks down at the street from behind."""
    source = source_of(street)
    sampled = sample_all(street, Clock.of(source.drive).around(FRAME))
    ego = source.drive.world_from_ego.at(source.drive.time_s[9])
    forward = np.array([0.8, 0.0, -0.6])
    pose = np.eye(4)
    pose[:3, :3] = ego[:3, :3] @ np.stack([[0.0, -1.0, 0.0], np.cross(forward, [0.0, -1.0, 0.0]), forward], 1)
    pose[:3, 3] = ego[:3, :3] @ [-16.0, 0.0, 20.0] + ego[:3, 3]
    poses = np.repeat((pose @ np.diag([1.0, -1.0, -1.0, 1.0]))[None], len(sampled.clock.frames), 0)
    np.testing.assert_allclose(optical(poses)[0], pose)
    model = CameraModel(*SIZE, 125.0, 125.0, 80.0, 50.0)
    view = SampledObject("viewport", "NONE", "", "", "", "", "", 0, poses, np.ones(len(poses), bool), model)
    asked = camera_request(sampled, view, source, FRAME, SIZE)
    assert asked.model == model
    return {**asked.values, "quality": "fast", "device": "cpu"}


def answers(jobs: Jobs, **request: Any) -> Iterator[tuple[dict[str, Any], dict[str, NDArray[Any]]]]:
    """Every event with arrays, and these; the file goes."""
    for event in jobs.camera(request):
        if event["event"] != "arrays":
            yield event, {}
            continue
        path = jobs.folder / event["file"]
        data = path.read_bytes()
        path.unlink()
        yield (
            event,
            {
                name: np.frombuffer(data, place["dtype"], int(np.prod(place["shape"])), place["offset"]).reshape(
                    place["shape"]
                )
                for name, place in event["arrays"].items()
            },
        )


def joined(found: list[tuple[dict[str, Any], dict[str, NDArray[Any]]]], name: str) -> NDArray[Any]:
    """The finished bands as one array."""
    return np.concatenate(
        [arrays[name] for event, arrays in found if event["event"] == "arrays" and tuple(event["stride"]) == (1, 1)]
    )


def test_a_view_with_confidence(jobs: Jobs, above: dict[str, Any]) -> None:
    """Progress comes first, then the image, whose finished bands have confidence; colours are those of a view without it."""
    plain = list(answers(jobs, **above, band=40))
    found = list(answers(jobs, **above, passes=["rgb", "confidence"], band=40))
    assert [event for event, _ in found if event["event"] == "progress"]
    np.testing.assert_array_equal(joined(found, "rgb"), joined(plain, "rgb"))
    confidence = joined(found, "confidence")
    assert confidence.shape == (SIZE[1], SIZE[0]) and 0 <= confidence.min() < confidence.max() <= 1
    again = list(answers(jobs, **above, passes=["rgb", "confidence"], band=40))
    assert not [event for event, _ in again if event["event"] == "progress"]
    np.testing.assert_array_equal(joined(again, "confidence"), confidence)


@pytest.mark.parametrize("clip", (False, True))
def test_unsupported_pixels_come_with_every_part(jobs: Jobs, above: dict[str, Any], clip: bool) -> None:
    asked = {**above, "passes": ["rgb", "unsupported"], "clip": clip}
    found = list(answers(jobs, **asked, coarse=[8, 4]))
    told = [event for event, _ in found if event["event"] == "progress"]
    assert told and "observed" in told[0]["text"] and 0 <= told[0]["share"] < 1
    parts = [(event, arrays) for event, arrays in found if event["event"] == "arrays"]
    assert [tuple(event["stride"]) for event, _ in parts[:2]] == [(8, 8), (4, 4)]
    assert all(set(arrays) == {"rgb", "unsupported"} for _, arrays in parts)
    whole = joined(found, "unsupported")
    assert whole.shape == SIZE[::-1] and 0.1 < whole.mean() < 0.9
    for event, arrays in parts[:2]:
        stride = event["stride"][0]
        assert (arrays["unsupported"] == whole[::stride, ::stride]).mean() > 0.97
    part = list(answers(jobs, **asked, rows=[30, 70], columns=[40, 90]))
    assert [event["event"] for event, _ in part] == ["arrays"] * len(part), "what was observed is worked out once"
    (left, right), top = part[0][0]["columns"], part[0][0]["rows"][0]
    bottom = part[-1][0]["rows"][1]
    assert left <= 40 and right >= 90 and top <= 30 and bottom >= 70
    np.testing.assert_array_equal(joined(part, "unsupported"), whole[top:bottom, left:right])


def test_nobody_gets_a_pass_that_was_not_asked_for(jobs: Jobs, above: dict[str, Any]) -> None:
    found = list(answers(jobs, **above, passes=["rgb"], clip=False))
    assert all(set(arrays) == {"rgb"} for _, arrays in found) and not jobs.spaces


def test_clipping_leaves_the_supported_road_as_it_is(jobs: Jobs, above: dict[str, Any]) -> None:
    views = [list(answers(jobs, **above, passes=["rgb", "unsupported"], clip=clip)) for clip in (False, True)]
    colours, unsupported = ([joined(view, name) for view in views] for name in ("rgb", "unsupported"))
    both = ~unsupported[0] & ~unsupported[1]
    same = (np.abs(colours[0] - colours[1]) < 0.05).all(-1)
    assert both.mean() > 0.2 and same[both].mean() > 0.85
    assert (unsupported[0] & unsupported[1]).mean() > 0.1
    assert not (~unsupported[0] & unsupported[1]).mean() > 0.1, "much that is supported is clipped"


def test_it_is_read_again_by_the_next_worker(jobs: Jobs, above: dict[str, Any], tmp_path: Path) -> None:
    asked = {**above, "passes": ["rgb", "unsupported"], "clip": True}
    first = list(answers(jobs, **asked))
    (tmp_path / "other").mkdir()
    second = list(answers(Jobs(tmp_path / "other"), **asked))
    assert [event["event"] for event, _ in first].count("progress") > 3
    assert "progress" not in [event["event"] for event, _ in second]
    np.testing.assert_array_equal(joined(first, "rgb"), joined(second, "rgb"))


@pytest.mark.parametrize("clip", (False, True))
def test_f12_is_clipped_where_that_is_asked_for(
    street: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, clip: bool
) -> None:
    """Through a camera that the log does not have alone."""
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    street.render.engine, street.render.resolution_percentage = "UNISIM", 20
    street.render.image_settings.file_format, street.render.image_settings.color_mode = "PNG", "RGBA"
    street.render.filepath, street.unisim.clip_render = str(tmp_path / "f12.png"), clip
    street.frame_set(int(FRAME))

    def clear() -> float:
        bpy.ops.render.render(write_still=True)
        alpha = np.asarray(Image.open(tmp_path / "f12.png"))[..., 3]
        assert set(np.unique(alpha)) <= {0, 255}
        return float((alpha == 0).mean())

    assert clear() == 0.0
    camera = bpy.data.objects.new("above", bpy.data.cameras.new("above"))
    street.collection.objects.link(camera)
    camera.location = street.camera.matrix_world.translation
    camera.location.z += 120.0
    street.camera = camera
    bpy.context.view_layer.update()
    assert 0.2 < clear() < 0.9 if clip else clear() == 0.0
