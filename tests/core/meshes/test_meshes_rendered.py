"""Meshes among the fields: in front of them and behind, seen by camera and LiDAR, smooth at their edges."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from analytic_scene import Stage, analytic_scene, block, drive_of, ground, renderer_of, still, union, wall
from PIL import Image

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.meshes.read import _read
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.scenario import (
    apply_scenario,
    load_scenario,
    save_scenario,
    scenario_from_json,
    scenario_to_json,
)
from unisim_blender.core.scenes.scene import mesh_digests
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.frames import CAMERA_PASSES
from unisim_blender.core.world.drive import Actor, Appearance, CameraModel

SIZE = np.array([4.0, 2.0, 2.0])
ALBEDO = np.array([255, 64, 0]) / 255


@pytest.fixture(scope="module")
def cube(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cube of 2 m."""
    path = tmp_path_factory.mktemp("mesh") / "cube.ply"
    box = trimesh.creation.box([2.0, 2.0, 2.0])
    box.visual.face_colors = [255, 64, 0, 255]
    box.export(path)
    return path


def mesh_actor(path: Path, position: list[float], size: float = 2.0, **changes: Any) -> Actor:
    return still("cube", position, [size] * 3, appearance=Appearance("cube", mesh=str(path)), inserted=True, **changes)


def stage(*actors: Actor) -> Stage:
    """Ground, a wall at x = 10, a car at (-6, 2.5), and what is given; the camera looks along x from (-20, 0, 1.6)."""
    scene = analytic_scene(union(ground, wall(10.0)), {"car": (block([3.6, 1.8, 1.6]), SIZE)})
    return Stage(scene, drive_of([still("car", [-6, 2.5, 1.0], SIZE), *actors]))


def test_a_mesh_takes_its_place_in_every_pass(cube: Path) -> None:
    bare = renderer_of(stage().as_scene(), stage().drive).camera("front", 0, CAMERA_PASSES)
    there = stage(mesh_actor(cube, [0, -1.5, 1.0]))
    renderer = renderer_of(there.as_scene(), there.drive)
    frame = renderer.camera("front", 0, CAMERA_PASSES)
    assert (
        frame.depth_m is not None
        and frame.z_depth_m is not None
        and frame.normal is not None
        and bare.normal is not None
    )
    assert frame.instance is not None and frame.unsupported is not None and frame.instances == ("car", "cube")
    mine = frame.instance == 2
    # its front face is 19 m away and 2 m wide: 40 * 2 / 19 pixels each way; of cells that it half covers
    # rounding # decides
    assert 12 <= mine.sum() <= 30
    np.testing.assert_allclose(np.median(frame.z_depth_m[mine]), 19.0, rtol=1e-3)
    assert (frame.normal[mine] @ [-1, 0, 0] > 0.9).mean() > 0.6
    assert not frame.unsupported[mine].any()
    # the colour is the mesh's own, whatever the networks hold
    colour = frame.rgb[mine].mean(0)
    assert colour[0] > 3 * colour[2] and colour[0] > colour[1]
    # nothing else changed, away from where the mesh's cells end
    rows, columns = np.nonzero(mine)
    beyond = np.ones_like(mine)
    beyond[rows.min() - 3 : rows.max() + 4, columns.min() - 3 : columns.max() + 4] = False
    np.testing.assert_array_equal(frame.rgb[beyond], bare.rgb[beyond])
    assert (frame.rgb != bare.rgb).any()


def test_a_car_hides_a_mesh_and_a_mesh_a_car(cube: Path) -> None:
    behind = stage(mesh_actor(cube, [-1.0, 2.5, 1.0]))
    frame = renderer_of(behind.as_scene(), behind.drive).camera("front", 0, ("rgb", "depth", "instance"))
    alone = renderer_of(stage().as_scene(), stage().drive).camera("front", 0, ("rgb", "depth", "instance"))
    assert frame.instance is not None and alone.instance is not None
    car = alone.instance == 1
    assert car.sum() > 20 and (frame.instance[car] == 1).mean() > 0.95
    front = stage(mesh_actor(cube, [-12.0, 1.3, 1.0]))
    frame = renderer_of(front.as_scene(), front.drive).camera("front", 0, ("rgb", "depth", "instance"))
    assert frame.instance is not None
    assert (frame.instance[car] == 2).mean() > 0.9


def test_a_band_of_the_image_is_the_images(cube: Path) -> None:
    there = stage(mesh_actor(cube, [-4, -1.0, 1.0]))
    renderer = renderer_of(there.as_scene(), there.drive, shadows=True)
    whole = renderer.camera("front", 0, CAMERA_PASSES)
    part = renderer.camera("front", 0, CAMERA_PASSES, region=Region(20, 10, 34, 23))
    np.testing.assert_allclose(part.rgb, whole.rgb[10:23, 20:34], atol=2e-6)
    assert part.depth_m is not None and whole.depth_m is not None
    np.testing.assert_allclose(part.depth_m, whole.depth_m[10:23, 20:34], rtol=1e-5)


def test_edges_are_as_smooth_as_what_they_cover(cube: Path) -> None:
    """How much of the image a face covers does not depend on how its edges fall on the pixels."""
    covered, partly = [], 0
    for shift in np.linspace(0, 0.25, 6):
        there = stage(mesh_actor(cube, [-9.0, shift, 1.6]))
        drive = there.drive
        camera = replace(drive.cameras["front"], model=CameraModel(48, 32, 40.0, 40.0, 24.0, 16.0))
        renderer = renderer_of(there.as_scene(), replace(drive, cameras={"front": camera}))
        cells = pixel_grid(camera.model, 2)
        time_s = camera.time_s[0]
        centres = camera_rays(camera, time_s, *cells).flat()
        active = renderer.renderer.tracer(renderer.state(camera, time_s)).active
        mesh_hits = active.mesh_actors.hit_by_camera(camera, time_s, cells, centres, 2, 0.5, lambda actor: np.ones(3))
        assert mesh_hits is not None and mesh_hits.pixels is not None
        covered.append(float(mesh_hits.pixels[..., 3].sum()))
        partly += int(((mesh_hits.pixels[..., 3] > 0) & (mesh_hits.pixels[..., 3] < 1)).sum())
    assert partly > 20
    np.testing.assert_allclose(covered, (40 * 2 / 10) ** 2, rtol=0.05)


def test_a_sweep_returns_from_a_mesh(cube: Path) -> None:
    there, bare = stage(mesh_actor(cube, [-10, 0.0, 1.6])), stage()
    frame = renderer_of(there.as_scene(), there.drive).lidar("top", 0)
    before = renderer_of(bare.as_scene(), bare.drive).lidar("top", 0)
    mine = frame.instance == 2
    assert mine.sum() >= 6 and frame.returned[mine].all()
    x = (frame.origins + frame.directions * frame.depth_m[..., None])[mine]
    np.testing.assert_allclose(x[:, 0], -11.0, atol=1e-4)
    cosine = frame.directions[mine][:, 0]
    grey = ((ALBEDO + 0.055) / 1.055) ** 2.4 @ [0.2126, 0.7152, 0.0722]
    np.testing.assert_allclose(frame.intensity[mine], grey * cosine, rtol=0.01)
    np.testing.assert_array_equal(frame.depth_m[~mine], before.depth_m[~mine])


def test_a_mesh_is_there_in_its_time_alone(cube: Path) -> None:
    there = stage(mesh_actor(cube, [-10, 0.0, 1.6], start_s=0.15, end_s=0.35))
    renderer = renderer_of(there.as_scene(), there.drive)
    frames = (renderer.camera("front", frame, ("rgb", "instance")) for frame in range(6))
    assert [frame.instance is not None and 2 in frame.instance for frame in frames] == [
        False,
        False,
        True,
        True,
        False,
        False,
    ]


def test_the_scenario_of_a_mesh(cube: Path, tmp_path: Path) -> None:
    base = stage()
    edit = {
        "type": "insert_mesh",
        "mesh": "cube.ply",
        "id": "c",
        "label": "Car",
        "pose": {"position": [1, 2, 3], "yaw_deg": 90},
    }
    document = {"format": "unisim-scenario", "version": 1, "name": "s", "log": "l", "edits": [edit]}
    scenario = scenario_from_json(document, cube.parent / "s.json")
    save_scenario(scenario, cube.parent / "s.json")
    assert scenario_to_json(load_scenario(cube.parent / "s.json")) == document
    actor = apply_scenario(scenario, base.drive, lambda path: {}).actors["c"]
    np.testing.assert_allclose(actor.size_m, 2.0)
    assert actor.label == "Car" and actor.inserted and actor.appearance.mesh == str(cube.resolve())
    missing = scenario_from_json(document, tmp_path / "s.json")
    with pytest.raises(ScenarioError, match=r"s.json: edits\[0\].mesh: .*cube.ply: cannot be read"):
        apply_scenario(missing, base.drive, lambda path: {})
    twice = scenario_from_json({**document, "edits": [{**edit, "id": "car"}]}, cube.parent / "s.json")
    with pytest.raises(ScenarioError, match='edits.0..id: "car" is an actor'):
        apply_scenario(twice, base.drive, lambda path: {})
    with pytest.raises(ScenarioError, match="needs pose or trajectory"):
        scenario_from_json({**document, "edits": [{k: v for k, v in edit.items() if k != "pose"}]}, tmp_path / "s.json")


def test_another_mesh_under_the_same_name_is_rendered_again(cube: Path, tmp_path: Path) -> None:
    mesh = tmp_path / "a.ply"
    mesh.write_bytes(cube.read_bytes())
    drive = stage(mesh_actor(mesh, [0, 0, 0])).drive
    before = mesh_digests(drive)
    mesh.write_bytes(cube.read_bytes() + b"\n")
    assert set(before) == {str(mesh)} and mesh_digests(drive) != before


@pytest.mark.parametrize("suffix", (".obj", ".ply"))
def test_a_mesh_with_another_texture_is_rendered_again(tmp_path: Path, suffix: str) -> None:
    mesh = tmp_path / f"a{suffix}"
    if suffix == ".obj":
        (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd a.png\n")
        mesh.write_text("mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    else:
        rows = "".join(f"property float {name}\n" for name in ("x", "y", "z", "s", "t"))
        head = f"ply\nformat ascii 1.0\ncomment TextureFile a.png\nelement vertex 3\n{rows}element face 1\n"
        mesh.write_text(
            f"{head}property list uchar int vertex_indices\nend_header\n0 0 0 0 0\n1 0 0 0 0\n0 1 0 0 0\n3 0 1 2\n"
        )
    drive = stage(mesh_actor(mesh, [0, 0, 0])).drive
    hashes = []
    for red in (200, 200, 30):
        Image.new("RGB", (2, 2), (red, 0, 0)).save(tmp_path / "a.png")
        _read.cache_clear()  # another process reads it
        hashes.append(mesh_digests(drive)[str(mesh)])
    assert hashes[0] == hashes[1] != hashes[2]
