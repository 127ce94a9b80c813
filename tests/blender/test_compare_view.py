"""Recorded beside rendered images: where an image lies in a view, its pixels, differences, views without
one, views' options."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import imported

from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.core.scenario import scenario_to_json
from unisim_blender.editing.images.comparison import (
    lacks_recorded,
    placement,
)
from unisim_blender.editing.reading.requests import CameraRequest, camera_request
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.scene import SampledObject
from unisim_blender.editing.sampled.source import DriveSource


def request(street: Any, view: Any, frame: float = 9.0) -> tuple[SampledObject, CameraRequest, DriveSource]:
    source = source_of(street)
    sampled = sample_all(street, Clock.of(source.drive).around(frame))
    looking = next(one for one in sampled.objects if one.name == view.name)
    return looking, camera_request(sampled, looking, source, frame, (480, 270)), source


def lack(street: Any, view: Any, frame: float = 9.0) -> str:
    looking, asked, source = request(street, view, frame)
    return lacks_recorded(looking, scenario_to_json(asked.scenario), source.drive, source.log, frame)


@pytest.fixture
def front(logged_street: Any) -> Any:
    return imported(logged_street, "CAMERA", "front_camera")


def test_a_recorded_camera_has_its_image(logged_street: Any, front: Any) -> None:
    assert lack(logged_street, front) == ""
    looking, asked, source = request(logged_street, front)
    model = asked.model
    found = placement(source.drive.cameras["front_camera"].model, model)
    assert found is not None and found.place == (0, 0, 480, 270)


def test_what_has_none_says_why(logged_street: Any, front: Any) -> None:
    assert "recorded image of frame 9.5" in lack(logged_street, front, 9.5)
    assert "recorded image of frame 40" in lack(logged_street, front, 40.0)
    looking, asked, source = request(logged_street, front)
    assert "log is not at hand" in lacks_recorded(looking, scenario_to_json(asked.scenario), source.drive, None, 9)
    nobody = SampledObject("viewport", "NONE", "", "", "", "", "", 0, looking.poses, looking.there, looking.camera)
    assert "look through a recorded camera" in lacks_recorded(
        nobody, scenario_to_json(asked.scenario), source.drive, source.log, 9
    )
    copy = front.copy()
    logged_street.collection.objects.link(copy)
    assert "added camera" in lack(logged_street, copy)


def test_a_camera_that_was_moved_has_none(logged_street: Any, front: Any) -> None:
    front.location.z += 0.01
    assert "not where it recorded" in lack(logged_street, front)
    front.location.z -= 0.01
    assert lack(logged_street, front) == ""
    imported(logged_street, "EGO", "ego").delta_location.y += 0.5
    assert "not where it recorded" in lack(logged_street, front)


def test_another_lens_still_shows_the_recorded_image(logged_street: Any, front: Any) -> None:
    front.data.lens *= 2
    assert lack(logged_street, front) == ""


def test_each_view_has_options_of_its_own(scene: Any) -> None:
    from unisim_blender.viewport.options import options_of

    spaces = [area.spaces.active for screen in bpy.data.screens for area in screen.areas if area.type == "VIEW_3D"]
    assert len(spaces) > 1
    options_of(spaces[0]).mode = "SPLIT"
    assert options_of(spaces[0]).mode == "SPLIT" and options_of(spaces[1]).mode == "RENDERED"
    assert options_of(spaces[1]).clip and not options_of(spaces[1]).unsupported
    options_of(spaces[0]).mode = "RENDERED"


def test_the_panel_sets_what_views_have(scene: Any) -> None:
    from unisim_blender.viewport.options import MODES, options_of

    holder = bpy.context.window_manager.unisim_view
    here = options_of(bpy.context.space_data)
    before = asdict(here)
    for name, *_ in MODES:
        holder.mode = name
        assert here.mode == name == holder.mode
    holder.split, holder.gain, holder.unsupported, holder.clip = 0.25, 8.0, True, False
    assert (here.split, here.gain, here.unsupported, here.clip) == (0.25, 8.0, True, False)
    for name, value in before.items():
        setattr(here, name, value)


def test_a_colour_of_all_points_lies_in_memory_point_by_point() -> None:
    from unisim_blender.viewport.overlay_layout import one_for_each

    for colours in ((0.25, 0.5, 0.75, 1.0), np.tile((0.25, 0.5, 0.75, 1.0), (3, 1))):
        each = one_for_each(colours, 3)
        assert np.frombuffer(each.tobytes("A"), np.float32).tolist() == 3 * [0.25, 0.5, 0.75, 1.0]
        assert each.strides == (16, 4)
