"""Logs in every layout that is read, imported: boxes stand where things were, and cameras look along the street's own rays."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import read

from unisim_blender.bridge.importing.backgrounds import background_to_show, sees_recorded_image, show_background
from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.objects.sensors import camera_model_of
from unisim_blender.bridge.sampling.stepping import moment
from unisim_blender.core.errors import install_into
from unisim_blender.core.geometry import FloatArray, rotate_vectors, transform_points
from unisim_blender.core.sensors.camera import camera_rays
from unisim_blender.core.world.drive import Camera
from unisim_blender.core.world.encoding import decode_sensor
from unisim_blender.editing.reading.requests import camera_request
from unisim_blender.editing.sampled.source import _newest

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
NEEDS = {"ncore": ["ncore", "scipy"], "argoverse2": ["pyarrow", "scipy"], "waymo": ["pyarrow", "scipy"]}
LAYOUTS = ("pandaset", "ncore", "argoverse2", "nuscenes", "kitti", "waymo")
ORIGIN_M, RAY_RAD, TIME_S = 5e-3, 2e-4, 1e-5
"""What layouts keep of cameras, at least."""


@dataclass
class Imported:
    """A log, and the Blender scene that it was imported into."""

    written: Any
    scene: Any


@pytest.fixture(scope="module", params=LAYOUTS)
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    for package in NEEDS.get(request.param, ["scipy"]):
        pytest.importorskip(package, reason=f"{request.param} needs {package}")
    from street_layouts import LAYOUTS as WRITERS

    return WRITERS[request.param](tmp_path_factory.mktemp("layout") / "log", 1)


@pytest.fixture
def imported(written: Any, scene: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Imported:
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path))
    assert bpy.ops.unisim.import_drive(filepath=str(written.dropped)) == {"FINISHED"}
    return Imported(written, bpy.context.scene)


def boxes_at(scene: Any, frame: int) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Places and sizes of the boxes that are shown at a frame."""
    scene.frame_set(frame)
    return {
        obj.unisim.uid: (np.array(obj.matrix_world.translation), np.array(obj.dimensions))
        for obj in imported_objects(scene, "ACTOR")
        if obj.visible_get()
    }


def assert_boxes(made: Imported, frame: int, true: Mapping[str, tuple[FloatArray, FloatArray]]) -> int:
    """Fail where a box is not where a thing of its size was; return how many there are."""
    shown = boxes_at(made.scene, frame)
    for uid, (place, size) in shown.items():
        away, of = min((float(np.linalg.norm(pose[:3, 3] - place)), name) for name, (pose, _) in true.items())
        assert away < made.written.box_m, (frame, uid, of, away)
        np.testing.assert_allclose(size, true[of][1], atol=1e-3)
    return len(shown)


def test_all_of_it_comes_in(imported: Imported) -> None:
    scene, drive = imported.scene, source_of(imported.scene).drive
    assert (scene.frame_start, scene.frame_end) == (drive.frames[0], drive.frames[-1]) and len(drive.frames) >= 4
    assert scene.render.engine == "UNISIM" and scene.camera.unisim.kind == "CAMERA"
    model = camera_model_of(scene.camera)
    assert (scene.render.resolution_x, scene.render.resolution_y) == (model.width, model.height)
    assert {o.unisim.uid for o in imported_objects(scene, "CAMERA")} == set(imported.written.cameras)
    assert len(list(imported_objects(scene, "LIDAR"))) == len(drive.lidars) > 0
    assert len(list(imported_objects(scene, "ACTOR"))) == len(drive.actors)
    assert read(scene).edits == () and source_of(scene).scene_path is None


def test_boxes_are_where_things_were(imported: Imported) -> None:
    from street_layouts import true_boxes

    drive, most = source_of(imported.scene).drive, 0
    for frame in drive.frames:
        true = true_boxes(imported.written, drive.time_s[frame], drive.world_origin)
        most = max(most, assert_boxes(imported, frame, true))
    assert most > 10


def test_cameras_look_along_the_streets_rays(imported: Imported) -> None:
    scene, source, written = imported.scene, source_of(imported.scene), imported.written
    assert source.log is not None
    shift = np.eye(4)
    shift[:3, 3] = -source.drive.world_origin
    move = shift @ written.common_from_street
    for name, true in written.cameras.items():
        (camera,) = (o for o in imported_objects(scene, "CAMERA") if o.unisim.uid == name)
        scene.camera = camera
        frames = [frame for frame in source.drive.frames if frame in source.log.image_frames(name)]
        assert frames
        for frame in (frames[0], frames[-1]):
            assert_rays(scene, source, camera, frame, true, move, written.later_s)


def assert_rays(scene: Any, source: Any, obj: Any, frame: int, true: Camera, move: FloatArray, later_s: float) -> None:
    """Fail where F12 would be asked for other rays than the street's camera has; ``move`` leads to the log's world."""
    scene.frame_set(frame)
    model = true.model
    layer = bpy.context.evaluated_depsgraph_get()
    sampled, view = moment(scene, layer, source, float(frame), scene.frame_set, obj)
    asked = camera_request(sampled, view, source, float(frame), (model.width, model.height)).values
    found = decode_sensor(asked["sensor"])
    assert isinstance(found, Camera)
    v, u = (part.ravel() + 0.5 for part in np.mgrid[: model.height : 5, : model.width : 5])
    rays = camera_rays(found, asked["time_s"], u, v)
    number = min(true.time_s, key=lambda n: abs(true.time_s[n] - later_s - asked["time_s"]))
    mine = camera_rays(true, true.time_s[number], u, v)
    seen = np.isfinite(mine.directions).all(-1)
    assert seen.any() and np.array_equal(seen, np.isfinite(rays.directions).all(-1))
    np.testing.assert_allclose(rays.time_s, mine.time_s - later_s, atol=TIME_S)
    np.testing.assert_allclose(rays.origins[seen], transform_points(move, mine.origins)[seen], atol=ORIGIN_M)
    np.testing.assert_allclose(rays.directions[seen], rotate_vectors(move, mine.directions)[seen], atol=RAY_RAD)


def test_recorded_images_stand_behind_the_cameras(imported: Imported) -> None:
    """Those of the frame that is shown, whatever their files are called."""
    scene, source = imported.scene, source_of(imported.scene)
    assert source.log is not None
    for camera in imported_objects(scene, "CAMERA"):
        (shown,) = camera.data.background_images
        width, height = shown.image.size
        model, uid = camera_model_of(camera), camera.unisim.uid
        assert (width, height) == (model.width, model.height) and camera.data.show_background_images
        for frame in [frame for frame in source.drive.frames if frame in source.log.image_frames(uid)]:
            scene.frame_set(frame)
            assert sees_recorded_image(scene, camera, source.drive)
            path = background_to_show(scene, camera, source.log)
            if shown.image.source == "SEQUENCE":
                user = shown.image_user
                number = frame - user.frame_start + 1 + user.frame_offset
                assert path is None and int(source.log.image_path(uid, frame).stem) == number  # type: ignore[union-attr]
                continue
            if path is not None:
                show_background(camera, path)
                assert background_to_show(scene, camera, source.log) is None
            assert Path(shown.image.filepath) == source.log.image_path(uid, frame)


def test_what_blenders_python_lacks_is_said_in_a_sentence(
    written: Any, scene: Any, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says what to install, and where; nothing comes in."""
    package = NEEDS.get(request.node.callspec.params["written"], [""])[0]
    if not package:
        pytest.skip("it needs nothing besides what the extension brings")
    _newest.clear()
    own = "unisim_blender.core.formats.ncore."
    for name in [name for name in sys.modules if name.startswith((f"{package}.", own)) and name != f"{own}layout"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    install_into("/home/her own/modules")
    try:
        with pytest.raises(RuntimeError) as told:
            bpy.ops.unisim.import_drive(filepath=str(written.dropped))
    finally:
        install_into("")
    sentence, distribution = str(told.value).strip(), {"ncore": "nvidia-ncore"}.get(package, package)
    assert f": this needs {package}, which Blender's Python does not have: run '{sys.executable}'" in sentence
    assert sentence.endswith(f"--target '/home/her own/modules' {distribution} and start Blender again")
    assert str(written.log) in sentence and "\n" not in sentence
    assert not scene.unisim.log and not any(obj.unisim.kind != "NONE" for obj in scene.objects)
