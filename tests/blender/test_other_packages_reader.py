"""A reader of somebody else's, installed where Blender's Python looks for a user's packages: its logs are imported, dropped and
rendered as the extension's own are."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
ROOT = Path(__file__).parents[2]

SCRIPT = """
import sys
from pathlib import Path

import bpy

name, log, picture, tests = "bl_ext.user_default.unisim_blender", *sys.argv[1:]
bpy.ops.preferences.addon_enable(module=name)
known = bpy.types.UNISIM_FH_json.bl_file_extensions.split(";")
assert ".json" in known and ".feather" in known and ".zip" not in known, known

# installed while Blender runs: the extension sees it when it is enabled again, as when Blender starts
bpy.ops.preferences.addon_disable(module=name)
sys.path.append(tests)
from other_package import install
place = Path(bpy.utils.user_resource("SCRIPTS"), "addons", "modules")
place.mkdir(parents=True)
install(place, "broken = zipped_pandaset:Unsuffixed\\nzipped = zipped_pandaset:ZippedPandaset")
sys.path.remove(tests)
assert str(place) in sys.path
assert "unisim_blender" not in sys.modules
bpy.ops.preferences.addon_enable(module=name)
known = bpy.types.UNISIM_FH_json.bl_file_extensions.split(";")
assert ".zip" in known and ".json" in known and len(known) == len(set(known)), known


def what_came_in():
    return sorted((one.unisim.kind, one.unisim.uid) for one in bpy.context.scene.objects if one.unisim.kind != "NONE")


assert bpy.ops.unisim.import_log(filepath=log) == {"FINISHED"}
imported = what_came_in()
assert ("CAMERA", "front_camera") in imported and ("ACTOR", "car-1") in imported and ("LIDAR", "pandar64") in imported
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.preferences.addon_enable(module=name)
assert not what_came_in()
assert bpy.ops.unisim.import_drive(filepath=log) == {"FINISHED"}
assert what_came_in() == imported

scene = bpy.context.scene
assert scene.unisim.log == log, scene.unisim.log
(shown,) = scene.camera.data.background_images
assert Path(shown.image.filepath).is_file() and tuple(shown.image.size) == (48, 32)
scene.render.filepath = picture
scene.render.image_settings.file_format = "PNG"
bpy.ops.render.render(write_still=True)
print("rendered")
"""


def test_its_logs_are_imported_dropped_and_rendered(tmp_path: Path) -> None:
    pytest.importorskip("bpy")
    import numpy as np
    from other_package import write_zipped
    from PIL import Image

    extensions = tmp_path / "user/extensions/user_default"
    extensions.mkdir(parents=True)
    (extensions / "unisim_blender").symlink_to(ROOT / "unisim_blender", target_is_directory=True)
    script, log, picture = tmp_path / "script.py", write_zipped(tmp_path), tmp_path / "picture.png"
    script.write_text(SCRIPT)
    environment = {"BLENDER_USER_RESOURCES": str(tmp_path / "user"), "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-P", str(script), str(log), str(picture), str(ROOT / "tests/support")],
        capture_output=True,
        text=True,
        env={**environment, "UNISIM_CACHE": str(tmp_path / "cache"), "UNISIM_PYTHON": sys.executable},
        cwd=tmp_path,
        timeout=300,
    )
    assert done.returncode == 0 and "rendered" in done.stdout, done.stdout + done.stderr
    assert "the reader 'broken' of zipped-pandaset is left out: TypeError: its suffixes are 'zip'" in done.stderr
    assert np.asarray(Image.open(picture))[..., :3].std() > 5, "the log's surfels, and no empty image"
