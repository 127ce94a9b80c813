"""The way from a scenario's file to rendered files with the neural renderer, on a scene of random weights."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from analytic_scene import renderer_of
from click.testing import CliRunner
from PIL import Image
from rendered_folder import contents
from tiny_drive import tiny_drive

from unisim_blender.core import native
from unisim_blender.core.cli.main import unisim
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.model.checkpoint import save_scene
from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.model.scene_file import SceneHeader
from unisim_blender.core.model.volume import Volume
from unisim_blender.core.presets import preset
from unisim_blender.core.render.quality import ERROR_BOUND_QUALITIES
from unisim_blender.core.scenes.recipe import Loaded, load_backend
from unisim_blender.core.scenes.scene import OpenScenes


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario on the tiny drive, whose scene has random weights and is occupied here and there."""
    folder = tmp_path_factory.mktemp("scene")
    drive = tiny_drive()
    torch.manual_seed(0)
    config = preset("tiny").model
    volume = Volume.along(drive, behind_m=10, ahead_m=30, width_m=30, height_m=10)
    model = SceneModel(config, volume, tuple(sorted(drive.actors)), tuple(drive.cameras))
    model.occupancy.values.copy_(torch.where(torch.rand(model.occupancy.values.shape) < 0.02, 255, 0))
    with torch.no_grad():
        output_layer(model.static)[0] = -0.1  # solid wherever it is occupied
        output_layer(model.lidar_head)[1] = 2.0  # and it returns
    header = SceneHeader(
        path=folder / "scene",
        name="random",
        log_name=drive.name,
        log_path="log",
        world_origin=drive.world_origin,
        model=config.to_dict(),
        volume=volume.to_dict(),
        drive=drive,
        training={"frames": [0, 2, 4], "cameras": ["front"], "lidars": ["top"], "width": None},
    )
    save_scene(folder / "scene", header, model)
    document = {
        "format": "unisim-scenario",
        "version": 1,
        "name": "tiny",
        "log": "log",
        "scene": "scene",
        "frames": [1, 2, 3],
        "edits": [{"type": "remove", "actor": "cone"}],
        "outputs": {"passes": ["rgb", "depth", "instance"], "formats": ["png", "exr", "npz", "labels"]},
    }
    path = folder / "scenario.json"
    path.write_text(json.dumps(document))
    return path


def output_layer(network: torch.nn.Module) -> torch.Tensor:
    """The bias of a network's last linear layer."""
    return next(
        part.bias
        for part in reversed(list(network.modules()))
        if isinstance(part, torch.nn.Linear) and part.bias is not None
    )


def render(*arguments: object) -> str:
    result = CliRunner().invoke(unisim, ["render", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_jobs_and_resuming_change_no_byte(scenario: Path, tmp_path: Path) -> None:
    render(scenario, "--out", tmp_path / "one", "--jobs", 1)
    render(scenario, "--out", tmp_path / "jobs", "--jobs", 2, "--frames", "1:3")
    render(scenario, "--out", tmp_path / "jobs", "--jobs", 2, "--resume")
    one = contents(tmp_path / "one")
    assert contents(tmp_path / "jobs") == one
    assert {"camera/front/000002.png", "camera/front/000002.exr", "lidar/top/000002.npz", "labels/000002.json"} < set(
        one
    )
    assert not [name for name in one if name.endswith(".ply")], "the scenario's formats have none"
    manifest = json.loads(one["manifest.json"])
    assert manifest["samples"]["samples_spent"] > 0
    assert str(scenario.parent) not in one["manifest.json"].decode(), "no paths: the same bytes wherever it lies"


def test_the_former_name_of_a_pass_gives_the_same_files(scenario: Path, tmp_path: Path) -> None:
    """``support`` is read as ``unsupported``: of a scenario file in silence, of the command line with a note."""
    document = json.loads(scenario.read_text())
    files = {}
    for name in ("support", "unsupported"):
        note = "Warning: --passes support: this pass is now called unsupported\n" if name == "support" else ""
        document["outputs"] = {"passes": ["rgb", name], "formats": ["exr"]}
        path = scenario.with_name(f"{name}.json")
        path.write_text(json.dumps(document))
        assert "Warning" not in render(path, "--out", tmp_path / f"file-{name}", "--jobs", 1, "--sensors", "front")
        files[f"file-{name}"] = contents(tmp_path / f"file-{name}")
        asked = [
            str(scenario),
            "--out",
            str(tmp_path / name),
            "--jobs",
            "1",
            "--sensors",
            "front",
            "--passes",
            f"depth,{name}",
        ]
        done = CliRunner().invoke(unisim, ["render", *asked], catch_exceptions=False)
        said = "".join(line for line in done.stderr.splitlines(keepends=True) if "Warning" in line)
        assert done.exit_code == 0 and said == note
        files[name] = contents(tmp_path / name)
    assert files["file-support"] == files["file-unsupported"] and files["support"] == files["unsupported"]
    for name in ("file-support", "support"):
        file = OpenEXR.File(str(tmp_path / name / "camera" / "front" / "000002.exr"), separate_channels=True)
        channels = file.parts[0].channels
        assert "unsupported" in channels and ("depth" in channels) == (name == "support")


def test_the_former_name_of_an_appearance_gives_the_same_files(scenario: Path, tmp_path: Path) -> None:
    """``look`` is read as ``appearance``: images, labels and the scenario's digest are the same."""
    document = json.loads(scenario.read_text())
    files = {}
    for name in ("look", "appearance"):
        document["edits"] = [{"type": "swap", "actor": "cone", name: "car"}]
        path = scenario.with_name(f"{name}.json")
        path.write_text(json.dumps(document))
        render(path, "--out", tmp_path / name, "--jobs", 1, "--sensors", "front")
        files[name] = contents(tmp_path / name)
    assert files["look"] == files["appearance"]


def test_a_bound_on_the_error_is_in_the_manifest(scenario: Path, tmp_path: Path) -> None:
    """With what was chosen and whether it is kept; the bytes hang on neither jobs nor resuming."""
    bounds = ("--max-error", "20dB", "--max-error", "500mm", "--max-error", "99dE")
    render(scenario, "--out", tmp_path / "one", "--jobs", 1, *bounds)
    render(scenario, "--out", tmp_path / "more", "--jobs", 2, "--frames", "2:4", *bounds)
    render(scenario, "--out", tmp_path / "more", "--jobs", 1, "--resume", *bounds)
    one = contents(tmp_path / "one")
    assert contents(tmp_path / "more") == one
    manifest = json.loads(one["manifest.json"])["max_error"]
    assert manifest["bounds"] == ["20dB", "500mm", "99dE"] and manifest["kept"] and manifest["not_kept"] == []
    assert set(manifest["frames"]) == {"000001", "000002", "000003"}
    for promises in manifest["frames"].values():
        camera, lidar = promises["camera/front"], promises["lidar/top"]
        assert set(camera["errors"]) == {"20dB", "99dE"} and set(lidar["errors"]) == {"500mm"}
        assert camera["errors"]["20dB"]["estimate"] >= camera["errors"]["20dB"]["at_worst"] >= 20
        assert lidar["errors"]["500mm"]["estimate"] <= lidar["errors"]["500mm"]["at_worst"] <= 500
        assert camera["settings"] in manifest["settings"] and lidar["settings"] in manifest["settings"]
    render(scenario, "--out", tmp_path / "plain", "--jobs", 1)
    assert "max_error" not in json.loads((tmp_path / "plain" / "manifest.json").read_bytes())


def test_a_bound_that_cannot_be_kept_is_owned_up_to(scenario: Path, tmp_path: Path) -> None:
    said = render(
        scenario, "--out", tmp_path / "out", "--jobs", 1, "--frames", "2", "--sensors", "front", "--max-error", "150dB"
    )
    assert "Warning: 1 images and sweeps may not keep 150dB, though rendered at the finest settings" in said
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_bytes())["max_error"]
    assert not manifest["kept"] and manifest["not_kept"] == ["000002: camera/front"]
    promise = manifest["frames"]["000002"]["camera/front"]
    assert not promise["kept"] and promise["settings"] == list(ERROR_BOUND_QUALITIES)[-1]


def test_a_bound_takes_the_place_of_a_quality(scenario: Path, tmp_path: Path) -> None:
    both = ["render", str(scenario), "--out", str(tmp_path / "out"), "--quality", "fast", "--max-error", "40dB"]
    with pytest.raises(UnisimError, match="--quality fast and --max-error 40dB: give one of the two"):
        CliRunner().invoke(unisim, both, catch_exceptions=False)
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(native.library() is None, reason="the compiled kernels were not built")
def test_a_scenario_is_rendered_without_torch(scenario: Path, tmp_path: Path) -> None:
    """In an interpreter that cannot import it, all formats, to the same bytes; --device auto is then the CPU."""
    render(scenario, "--out", tmp_path / "with", "--jobs", "1")
    blocked = "import sys; sys.modules.update(dict.fromkeys(('torch', 'scipy', 'skimage', 'safetensors')))\n"
    asked = ["render", str(scenario), "--out", str(tmp_path / "without"), "--jobs", "1", "--device", "auto"]
    program = f"{blocked}from unisim_blender.core.cli.main import run\nsys.exit(run({asked!r}))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    files = [path.relative_to(tmp_path / "with") for path in (tmp_path / "with").rglob("*") if path.is_file()]
    assert len(files) > 10
    for file in files:
        if file.suffix in (".png", ".exr", ".npz"):
            assert (tmp_path / "with" / file).read_bytes() == (tmp_path / "without" / file).read_bytes(), file


def test_command_line_goes_before_the_scenario(scenario: Path, tmp_path: Path) -> None:
    arguments = ("--frames", 5, "--sensors", "front", "--passes", "rgb", "--width", 16, "--jobs", 1)
    output = render(scenario, "--out", tmp_path / "out", *arguments)
    assert "1 frames rendered" in output
    assert Image.open(tmp_path / "out/camera/front/000005.png").size == (16, 9)
    assert not (tmp_path / "out/lidar").exists()
    labels = json.loads((tmp_path / "out/labels/000005.json").read_text())
    assert [box["id"] for box in labels["boxes"]] == ["car"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--sensors", "nose"], 'sensor "nose": is not one of front, top'),
        (["--passes", "heat"], 'pass "heat"'),
        (["--frames", "90:"], "selects none"),
    ],
)
def test_unknown_names_are_refused_before_anything_is_written(
    arguments: list[str], sentence: str, scenario: Path, tmp_path: Path
) -> None:
    result = CliRunner().invoke(unisim, ["render", str(scenario), "--out", str(tmp_path / "out"), *arguments])
    assert sentence in str(result.exception) and not (tmp_path / "out").exists()


def test_edits_change_the_key_and_paths_do_not(scenario: Path) -> None:
    from unisim_blender.core.prepare.scenario_plan import RenderOptions, plan_scenario
    from unisim_blender.core.sequence.plan import CaptureIdentities

    plan, _ = plan_scenario(scenario, RenderOptions())
    other, _ = plan_scenario(scenario, RenderOptions(frames="0:2"))
    identities = CaptureIdentities(plan).of_frame(1)
    assert CaptureIdentities(other).of_frame(1) == identities, "which frames are asked for changes none of them"
    rescened = CaptureIdentities(replace(plan, scenes={"": "0" * 64})).of_frame(1)
    assert all(rescened[name][0] != identity for name, (identity, _) in identities.items())


def test_plain_points_without_a_beam_table_are_no_sensor(scenario: Path, tmp_path: Path) -> None:
    shutil.copytree(scenario.parent / "scene", tmp_path / "scene")
    header = json.loads((tmp_path / "scene" / "scene.json").read_text())
    lidars = header["drive"]["lidars"]
    plain = lidars["top"]["model"] | {"elevation_rad": [], "azimuth_offset_rad": []}
    lidars["plain"] = lidars["top"] | {"model": plain}
    (tmp_path / "scene" / "scene.json").write_text(json.dumps(header))
    shutil.copy(scenario, tmp_path)
    render(tmp_path / scenario.name, "--out", tmp_path / "out", "--frames", 1, "--jobs", 1)
    assert [path.name for path in (tmp_path / "out" / "lidar").iterdir()] == ["top"]
    asked = ["render", str(tmp_path / scenario.name), "--out", str(tmp_path / "other"), "--sensors", "plain"]
    result = CliRunner().invoke(unisim, asked)
    assert str(result.exception) == 'sensor "plain": is not one of front, top'


def test_images_are_not_constant(scenario: Path, tmp_path: Path) -> None:
    render(scenario, "--out", tmp_path / "out", "--frames", 1, "--jobs", 1)
    images = np.asarray(Image.open(tmp_path / "out/camera/front/000001.png"))
    assert images.std() > 0


def test_a_scene_agrees_with_the_log_that_it_rendered(scenario: Path, tmp_path: Path) -> None:
    """Render the unedited drive as a log and evaluate the scene against it: what is left is JPEG's and
    float32's error."""
    document = json.loads(scenario.read_text()) | {"edits": [], "frames": [0, 1, 2, 3]}
    unedited = scenario.with_name("unedited.json")
    unedited.write_text(json.dumps(document))
    render(unedited, "--out", tmp_path / "out", "--jobs", 1, "--format", "pandaset")
    arguments = ["eval", scenario.parent / "scene", tmp_path / "out/pandaset", "--out", tmp_path / "eval"]
    result = CliRunner().invoke(unisim, [str(part) for part in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    metrics = json.loads((tmp_path / "eval/metrics.json").read_text())
    assert metrics["frames"] == [1, 3], "those that were not trained on"
    assert metrics["camera"]["psnr_db"] > 38 and metrics["camera"]["ssim"] > 0.9
    assert metrics["camera"]["driving"]["images"] == 2
    lidar = metrics["lidar"]
    assert lidar["sweeps"] == 2 and lidar["hit_rate"] > 0.99 and lidar["drop_accuracy"] > 0.99
    assert lidar["depth_p90_m"] < 1e-4 and lidar["chamfer_m"] < 1e-4
    assert (tmp_path / "eval/index.html").is_file()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--split", "seed10"], "001: is missing"),
        (["--cameras", "nose"], 'camera "nose"'),
        (["--lpips", "gone.pth"], "gone.pth"),
    ],
)
def test_evaluation_refuses_what_is_not_there(
    arguments: list[str], sentence: str, scenario: Path, tmp_path: Path
) -> None:
    render(scenario, "--out", tmp_path / "out", "--jobs", 1, "--format", "pandaset")
    paths = [str(scenario.parent / "scene"), str(tmp_path / "out/pandaset")]
    result = CliRunner().invoke(unisim, ["eval", *paths, "--out", str(tmp_path / "eval"), *arguments])
    assert sentence in str(result.exception) and not (tmp_path / "eval").exists()


def test_contact_shadows_lie_under_new_actors_alone(scenario: Path) -> None:
    from unisim_blender.core.model.checkpoint import load_scene
    from unisim_blender.core.render.lattice import Region

    scene = load_scene(scenario.parent / "scene")
    drive = scene.header.drive
    car = drive.actors["car"]
    plain = renderer_of(scene, drive).camera("front", 2).rgb
    assert np.array_equal(renderer_of(scene, drive, shadows=True).camera("front", 2).rgb, plain)
    edited = replace(drive, actors={**drive.actors, "new": replace(car, uid="new", inserted=True)})
    light = renderer_of(scene, edited).camera("front", 2, ("rgb", "instance", "depth"))
    dark = renderer_of(scene, edited, shadows=True).camera("front", 2)
    assert dark.depth_m is None and dark.instance is None
    changed = (dark.rgb != light.rgb).any(-1)
    assert light.instance is not None and (light.instance[changed] == 0).all()
    assert (dark.rgb <= light.rgb + 1e-6).all()
    part = renderer_of(scene, edited, shadows=True).camera("front", 2, region=Region(4, 3, 20, 15)).rgb
    assert np.abs(part - dark.rgb[3:15, 4:20]).max() < 1e-5


def test_scenes_are_loaded_once_until_they_change(scenario: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(scenario.parent / "scene", tmp_path / "scene"))
    scenes, loaded = OpenScenes(), Loaded()
    load_backend(scenes.open(folder), loaded=loaded)
    (first,) = loaded.values()
    load_backend(scenes.open(folder), {}, "fast", loaded=loaded)
    (again,) = loaded.values()
    assert again is first
    os.utime(folder / "weights.safetensors", ns=(1, 1))
    load_backend(scenes.open(folder), loaded=loaded)
    (changed,) = loaded.values()
    assert changed is not first, "and the one before is forgotten"
