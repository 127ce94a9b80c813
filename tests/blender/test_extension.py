"""The .zip: built, checked by Blender's own tool, installed, enabled, and rendering with what it brought."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import tomllib
from PIL import Image

ROOT = Path(__file__).parents[2]
WEBSITE = "https://example.org/unisim?for=blender"

INSTALL = """
import sys, bpy
path = sys.argv[1]
bpy.ops.extensions.package_install_files(filepath=path, repo="user_default", enable_on_install=True, overwrite=True)
name = "bl_ext.user_default.unisim_blender"
assert name in bpy.context.preferences.addons, list(bpy.context.preferences.addons.keys())
assert bpy.ops.unisim.import_scene(filepath=sys.argv[2]) == {"FINISHED"}
assert any(o.unisim.kind == "ACTOR" for o in bpy.context.scene.objects)
assert "torch" not in sys.modules
assert bpy.ops.unisim.test_renderer() == {"FINISHED"}
print(bpy.context.window_manager.unisim_renderer)
scene = bpy.context.scene
scene.camera = next(o for o in scene.objects if o.unisim.kind == "CAMERA")
scene.render.engine = "UNISIM"
scene.render.resolution_percentage = 20
scene.render.filepath = sys.argv[3]
scene.render.image_settings.file_format = "PNG"
bpy.ops.render.render(write_still=True)
assert bpy.ops.unisim.show_points(recorded=False, simulated=True) == {"FINISHED"}
(points,) = [o for o in scene.objects if o.unisim.uid.endswith(" simulated")]
assert len(points.data.vertices) > 1000
scene.frame_start, scene.frame_end, scene.unisim.out = 3, 4, sys.argv[4]
assert bpy.ops.unisim.render_sequence() == {"FINISHED"}
bpy.ops.preferences.addon_disable(module=name)
assert not hasattr(bpy.types.Scene, "unisim")
print("installed")
"""


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The extension, built."""
    out = tmp_path_factory.mktemp("dist")
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools" / "build_extension.py"), str(out)],
        capture_output=True,
        text=True,
        env={**os.environ, "WEBSITE": WEBSITE},
    )
    if done.returncode and "pip" in done.stderr and "download" in done.stderr:
        pytest.skip("the wheels cannot be fetched: no network")
    assert done.returncode == 0, done.stdout + done.stderr
    return next(out.glob("*.zip"))


def test_it_is_small_and_whole(archive: Path) -> None:
    """Our licence and those of all wheels, one platform, no torch; Blender keeps one wheel of a name."""
    content = zipfile.ZipFile(archive)
    names = content.namelist()
    assert archive.stat().st_size < 22 << 20
    assert {"LICENSE", "core/rigs/KITTI-like.json"} < set(names)
    for plug_in in ("unisim_bench", "unisim_street"):
        sources = {path.relative_to(ROOT) for path in (ROOT / plug_in).rglob("*.py")}
        assert {f"bundled/{path.as_posix()}" for path in sources} <= set(names), plug_in
    package = ROOT / "unisim_blender"
    assert {path.relative_to(package).as_posix() for path in package.rglob("*.py")} <= set(names), "every module"
    assert [name for name in names if Path(name).name.startswith("_unisim_native.")], "the compiled kernels"
    wheels = [name for name in names if name.endswith(".whl")]
    manifest = tomllib.loads(content.read("blender_manifest.toml").decode())
    assert sorted(Path(name).name for name in manifest["wheels"]) == sorted(Path(name).name for name in wheels)
    assert len(manifest["platforms"]) == 1 and manifest["website"] == WEBSITE
    packages = [Path(name).name.partition("-")[0] for name in wheels]
    assert len(set(packages)) == len(packages) and not {"torch", "numpy", "scipy"} & set(packages)
    for name in wheels:
        inside = zipfile.ZipFile(io.BytesIO(content.read(name)))
        assert inside.testzip() is None
        texts = [Path(member).name.upper() for member in inside.namelist() if ".dist-info/" in member]
        assert any(text.startswith(("LICENSE", "LICENCE", "COPYING")) for text in texts), f"{name} has no licence"


def test_its_plug_ins_are_found_and_are_its_own(archive: Path, tmp_path: Path) -> None:
    """Also by an interpreter that has other copies installed."""
    extension = tmp_path / "extension"
    zipfile.ZipFile(archive).extractall(extension)
    command = extension / "bundled" / "unisim_street" / "commands" / "synth.py"
    command.write_text(command.read_text() + "\nprint('the copy of the extension')\n")
    street = tmp_path / "street"
    arguments = ["cli", "synth", str(street), "--frames", "2", "--width", "32", "--height", "18", "--jobs", "1"]
    done = subprocess.run(
        [sys.executable, "-I", str(extension / "bootstrap.py"), "", *arguments], capture_output=True, text=True
    )
    assert done.returncode == 0 and done.stdout.count("the copy of the extension") == 1, done.stdout + done.stderr
    assert (street / "street.json").is_file()


def test_a_website_that_is_no_address_is_refused(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools" / "build_extension.py"), str(tmp_path), "missing.whl"],
        capture_output=True,
        text=True,
        env={**os.environ, "WEBSITE": 'unisim" \n'},
    )
    assert done.returncode == 1 and "WEBSITE" in done.stderr and not list(tmp_path.iterdir()), done.stderr


def test_it_installs_enables_imports_and_renders(archive: Path, bare: Path, tmp_path: Path) -> None:
    """Image, sweep and sequence, where nothing but numpy is installed; that training needs more is said."""
    script = tmp_path / "install.py"
    script.write_text(INSTALL)
    image = tmp_path / "picture.png"
    frames = tmp_path / "frames"
    environment = {"BLENDER_USER_RESOURCES": str(tmp_path / "user"), "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
    environment["UNISIM_PYTHON"] = str(bare)
    scene = ROOT / "sample" / "scene" / "scene.json"
    done = subprocess.run(
        [sys.executable, str(script), str(archive), str(scene), str(image), str(frames)],
        capture_output=True,
        text=True,
        env=environment,
        timeout=300,
    )
    assert done.returncode == 0 and "installed" in done.stdout, done.stdout + done.stderr
    assert f"Renders with {bare}" in done.stdout and "Training needs an interpreter with torch" in done.stdout
    shown = np.asarray(Image.open(image))
    assert shown[..., :3].std() > 10, "a street, and no empty image"
    assert len(list((frames / "camera").glob("*/*.png"))) == len(list((frames / "lidar").glob("*/*.ply"))) == 2
