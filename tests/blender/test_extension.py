"""The .zip: built, checked by Blender's own tool, installed, enabled."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

INSTALL = """
import sys, bpy
path = sys.argv[1]
bpy.ops.extensions.package_install_files(filepath=path, repo="user_default", enable_on_install=True, overwrite=True)
name = "bl_ext.user_default.unisim_blender"
assert name in bpy.context.preferences.addons, list(bpy.context.preferences.addons.keys())
assert bpy.ops.unisim.import_scene(filepath=sys.argv[2]) == {"FINISHED"}
assert any(o.unisim.kind == "ACTOR" for o in bpy.context.scene.objects)
assert "torch" not in sys.modules
scene = bpy.context.scene
scene.render.engine = "UNISIM"
scene.render.resolution_percentage = 20
scene.render.filepath = sys.argv[3]
scene.render.image_settings.file_format = "PNG"
bpy.ops.render.render(write_still=True)
bpy.ops.preferences.addon_disable(module=name)
assert not hasattr(bpy.types.Scene, "unisim")
print("installed")
"""


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The extension, built."""
    out = tmp_path_factory.mktemp("dist")
    done = subprocess.run([sys.executable, str(ROOT / "tools" / "build_extension.py"), str(out)], capture_output=True, text=True)
    if done.returncode and "pip" in done.stderr and "download" in done.stderr:
        pytest.skip("the wheels cannot be fetched: no network")
    assert done.returncode == 0, done.stdout + done.stderr
    return next(out.glob("*.zip"))


def test_it_is_small_and_holds_no_torch(archive: Path) -> None:
    names = zipfile.ZipFile(archive).namelist()
    assert archive.stat().st_size < 5 << 20
    assert not any("torch-" in name for name in names)
    assert "core/scenario/schema.json" in " ".join(names)


def test_it_installs_enables_imports_and_renders(archive: Path, tmp_path: Path) -> None:
    script = tmp_path / "install.py"
    script.write_text(INSTALL)
    picture = tmp_path / "picture.png"
    environment = {"BLENDER_USER_RESOURCES": str(tmp_path / "user"), "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
    scene = ROOT / "sample" / "scene" / "scene.json"
    done = subprocess.run(
        [sys.executable, str(script), str(archive), str(scene), str(picture)],
        capture_output=True,
        text=True,
        env=environment,
        timeout=300,
    )
    assert done.returncode == 0 and "installed" in done.stdout, done.stdout + done.stderr
    assert picture.is_file()
