"""Build the Blender extension for one platform: our wheel's package and compiled library, and the wheels that rendering
needs in Blender's own Python, in one .zip, checked by Blender itself.

python tools/build_extension.py [OUT] [WHEEL]   (WHEEL: of this package, for any platform; built here if none is named)

Whoever publishes the extension names its website in the environment's `WEBSITE`, and Blender shows it.
"""

from __future__ import annotations

import base64
import hashlib
import os
import re
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import bpy
from build_manual import build as build_manual

ROOT = Path(__file__).resolve().parents[1]
PURE = (
    "jsonschema==4.17.3",
    "attrs==26.1.0",
    "pyrsistent==0.20.0",
    "trimesh==5.2.0",
    "click==8.5.1",
    "tqdm==4.70.1",
    "plyfile==1.1.3",
    "fsspec==2026.9.0",
    "jsonpointer==3.12",
    "pip==26.3",
)
"""The newest jsonschema that needs nothing compiled. Wheels come before Blender's own modules of these names, so an old
one would break what Blender does with it. pip installs optional packages: not every Blender's Python has one."""
COMPILED = ("pillow==13.0.0", "OpenEXR==3.5.3")
PYTHONS = ("311", "313", "314")
"""Blender's own Python up to 5.0 and since, and the newest of distributions that build Blender with theirs."""
PLUG_INS = ("unisim_bench", "unisim_street")
"""Packages of our wheel that its entry points name: `bootstrap.py` finds them in the folder "bundled"."""
PLATFORMS = {
    "linux_x86_64": ("linux-x64", ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux2014_x86_64")),
    "linux_aarch64": ("linux-arm64", ("manylinux_2_28_aarch64", "manylinux_2_27_aarch64", "manylinux2014_aarch64")),
    "win_amd64": ("windows-x64", ("win_amd64",)),
    "macosx_arm64": ("macos-arm64", ("macosx_11_0_arm64",)),
}
"""Blender's name of a platform and pip's, oldest systems that are served, by the outer parts of a wheel's platform."""


def blender_ext(*arguments: str) -> None:
    """Run Blender's own tool for extensions."""
    script = Path(bpy.utils.resource_path("LOCAL")) / "scripts" / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"
    subprocess.run([sys.executable, str(script), *arguments], check=True)


def pip(*arguments: str) -> None:
    """Run pip."""
    subprocess.run([sys.executable, "-m", "pip", *arguments[:1], "--quiet", "--no-deps", *arguments[1:]], check=True)


def build_wheel(folder: Path) -> Path:
    """Our wheel for the machine at hand; the compilation is kept in build/ for the next time."""
    pip("wheel", "--no-build-isolation", "--wheel-dir", str(folder), str(ROOT))
    return next(folder.glob("unisim_blender-*.whl"))


def platform_of(wheel: Path) -> tuple[str, tuple[str, ...]]:
    """The entry of `PLATFORMS` for a wheel."""
    tag = wheel.stem.split("-")[-1].split(".")[0].replace("manylinux", "linux")
    machine = next((name for name in ("x86_64", "aarch64", "amd64", "arm64") if tag.endswith(name)), "")
    key = f"{tag.partition('_')[0].rstrip('0123456789')}_{machine}"
    if key not in PLATFORMS:
        raise SystemExit(
            f"Error: {wheel.name}: Blender runs on none of its platforms; there are {', '.join(PLATFORMS)}"
        )
    return PLATFORMS[key]


def merged(wheels: list[Path], folder: Path) -> Path:
    """Wheels of one release for several Pythons as one: their compiled modules are told apart by name, all
    else is the same.

    Of wheels that differ in their Python alone Blender 4.2 keeps the last by name, whether it fits or not.
    """
    members: dict[str, bytes] = {}
    tags = []
    for path in wheels:
        with zipfile.ZipFile(path) as archive:
            for name in archive.namelist():
                data = archive.read(name)
                if name.endswith(".dist-info/WHEEL"):
                    tags += [line for line in data.splitlines() if line.startswith(b"Tag:")]
                elif ".dist-info/" not in name and members.get(name, data) != data:
                    raise SystemExit(f"Error: {path.name}: its {name} is another than that of {wheels[0].name}")
                members.setdefault(name, data)
    about = next(name for name in members if name.endswith(".dist-info/WHEEL"))
    kept = [line for line in members[about].splitlines() if line and not line.startswith(b"Tag:")]
    members[about] = b"\n".join([*kept, *tags, b""])
    record = about.replace("WHEEL", "RECORD")
    rows = []
    for name, data in members.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).decode().rstrip("=")
        rows.append(f"{name},,\n" if name == record else f"{name},sha256={digest},{len(data)}\n")
    members[record] = "".join(rows).encode()
    release, platform = wheels[0].name.split("-cp")[0], wheels[0].stem.split("-")[-1]
    pythons = ".".join(f"cp{python}" for python in PYTHONS)
    out = folder / f"{release}-{pythons}-{pythons}-{platform}.whl"
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return out


def fetch_wheels(platforms: tuple[str, ...], folder: Path) -> None:
    """The wheels of what rendering needs into a folder."""
    common = ["--only-binary=:all:"]
    pip(
        "download",
        *common,
        "--implementation",
        "py",
        "--abi",
        "none",
        "--platform",
        "any",
        "--dest",
        str(folder),
        *PURE,
    )
    named = [argument for platform in platforms for argument in ("--platform", platform)]
    for package in COMPILED:
        with tempfile.TemporaryDirectory() as place:
            for python in PYTHONS:
                wanted = ["--implementation", "cp", "--python-version", python, "--abi", f"cp{python}", *named]
                pip("download", *common, *wanted, "--dest", place, package)
            merged(sorted(Path(place).glob("*.whl")), folder)


def website_line(website: str) -> str:
    """The manifest's line of an address that Blender opens for "Visit Website"; empty if there is none."""
    if website and re.fullmatch(r'https?://[^\s"\\]+', website) is None:
        raise SystemExit(f"Error: WEBSITE: {website!r} is not an address of the form https://…")
    return f'website = "{website}"\n' if website else ""


def build(out: Path, wheel: Path | None = None) -> Path:
    """The .zip's path."""
    website = website_line(os.environ.get("WEBSITE", ""))
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        wheel = wheel or build_wheel(Path(folder))
        blender_platform, pip_platforms = platform_of(wheel)
        # The library stays beside the sources that call it: in a wheel of its own, one extension's would serve
        # another version's.
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(folder)
        staged = Path(folder) / "unisim_blender"
        bundled = staged / "bundled"
        bundled.mkdir()
        for plug_in in (*PLUG_INS, *(path.name for path in Path(folder).glob("unisim_blender-*.dist-info"))):
            (Path(folder) / plug_in).rename(bundled / plug_in)
        (staged / "LICENSE").write_bytes((ROOT / "LICENSE").read_bytes())
        build_manual(staged / "manual")
        wheels = staged / "wheels"
        wheels.mkdir()
        fetch_wheels(pip_platforms, wheels)
        manifest = staged / "blender_manifest.toml"
        names = ", ".join(f'"./wheels/{path.name}"' for path in sorted(wheels.glob("*.whl")))
        filled = f'platforms = ["{blender_platform}"]\nwheels = [{names}]'
        manifest.write_text(manifest.read_text().replace("wheels = []", website + filled))
        blender_ext("build", "--split-platforms", "--source-dir", str(staged), "--output-dir", str(out))
    path = max(out.glob("unisim_blender-*.zip"), key=lambda p: p.stat().st_mtime)
    tags = Path(bpy.utils.resource_path("LOCAL")) / "scripts" / "modules" / "_bpy_internal" / "extensions" / "tags.py"
    blender_ext("validate", "--valid-tags", str(tags), str(path))
    return path


if __name__ == "__main__":
    print(
        build(
            Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "dist", Path(sys.argv[2]) if len(sys.argv) > 2 else None
        )
    )
