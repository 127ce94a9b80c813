"""Build the Blender extension: the package, its compiled kernels and a few small wheels in one .zip, checked by Blender itself.

python tools/build_extension.py [OUT]
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import bpy

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "unisim_blender"
WHEELS = ("jsonschema==4.17.3", "attrs==26.1.0", "pyrsistent==0.20.0", "trimesh==5.2.0")
"""What Blender's own Python lacks for checking scenarios and reading meshes; the newest that need nothing compiled. They come
before Blender's own modules of these names, so an old one would break what Blender does with it."""


def blender_ext(*arguments: str) -> None:
    """Run Blender's own tool for extensions."""
    script = Path(bpy.utils.resource_path("LOCAL")) / "scripts" / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"
    subprocess.run([sys.executable, str(script), *arguments], check=True)


def build(out: Path) -> Path:
    """The .zip's path."""
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        staged = Path(folder) / "unisim_blender"
        shutil.copytree(PACKAGE, staged, ignore=shutil.ignore_patterns("__pycache__", "*.pyc"))
        shutil.copy(ROOT / "LICENSE", staged / "LICENSE")
        wheels = staged / "wheels"
        pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:", "--implementation", "py"]
        subprocess.run([*pip, "--abi", "none", "--platform", "any", "--dest", str(wheels), *WHEELS], check=True)
        manifest = staged / "blender_manifest.toml"
        names = ", ".join(f'"./wheels/{path.name}"' for path in sorted(wheels.glob("*.whl")))
        manifest.write_text(manifest.read_text().replace("wheels = []", f"wheels = [{names}]"))
        blender_ext("build", "--source-dir", str(staged), "--output-dir", str(out))
    path = max(out.glob("unisim_blender-*.zip"), key=lambda p: p.stat().st_mtime)
    tags = Path(bpy.utils.resource_path("LOCAL")) / "scripts" / "modules" / "_bpy_internal" / "extensions" / "tags.py"
    blender_ext("validate", "--valid-tags", str(tags), str(path))
    return path


if __name__ == "__main__":
    print(build(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "dist"))
