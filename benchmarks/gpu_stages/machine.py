"""What it is measured on, and the native library, which is built where none runs."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import time
from pathlib import Path

from .settings import ROOT, Findings, Settings

CORE = ROOT / "unisim_blender" / "core"


def said(*command: str) -> str | None:
    """Return what a command prints, or None where there is none or it fails."""
    if shutil.which(command[0]) is None:
        return None
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    return done.stdout.strip() if done.returncode == 0 else None


def source_hash() -> str:
    """Return a hash of the package's and the library's sources, which tells what ran where no commit travels along."""
    files = sorted([*CORE.rglob("*.py"), *(path for path in (ROOT / "native").rglob("*.*")), ROOT / "CMakeLists.txt"])
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.relative_to(ROOT)}\n".encode() + file.read_bytes())
    return digest.hexdigest()[:16]


def machine(settings: Settings, found: Findings) -> None:
    """Note versions, device and sources."""
    import numpy
    import torch

    found.note(
        python=platform.python_version(), torch=torch.__version__, cuda_of_torch=torch.version.cuda,
        numpy=numpy.__version__,
        cores=os.cpu_count(),
        nvcc=(said("nvcc", "--version") or "").splitlines()[-1:] or None, commit=said("git", "rev-parse", "HEAD"),
        changed_files=len((said("git", "status", "--porcelain", "--", "unisim_blender/core", "native") or "").splitlines()),
        source_hash=source_hash(),
        system=platform.platform(), processor=_processor(), device=settings.device,
    )  # fmt: skip
    if settings.device.startswith("cuda"):
        about = torch.cuda.get_device_properties(settings.device)
        found.note(
            gpu=about.name, gpu_memory_bytes=about.total_memory, capability=list(torch.cuda.get_device_capability()),
            driver=said("nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"),
        )  # fmt: skip


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next(
        (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.processor()
    )


def build_native(settings: Settings, found: Findings) -> None:
    """Build the native library beside its loader, unless one runs there; raise where it cannot be built:
    torch goes on alone."""
    before = native_variant()
    found.note(before=before)
    if before != "torch":
        found.note(variant=before, built=False)
        return
    cmake = shutil.which("cmake")
    if cmake is None:
        raise RuntimeError("the native library could not be built: there is no cmake; plain torch takes its place")
    folder, begun = Path(settings.work) / "native", time.monotonic()
    options = ["-DSKBUILD_STATE=editable", "-DSKBUILD_PROJECT_NAME=unisim_blender", "-DCMAKE_BUILD_TYPE=Release"]
    if shutil.which("ninja"):
        options.append("-GNinja")
    for command in (
        [cmake, "-S", str(ROOT), "-B", str(folder), *options],
        [cmake, "--build", str(folder), "--parallel", str(os.cpu_count() or 1)],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(
                f"the native library could not be built: {' '.join(command)}\n{(done.stdout + done.stderr)[-4000:]}"
            )
    found.note(variant=native_variant(), built=True, build_s=round(time.monotonic() - begun, 1))
    if found.values["variant"] == "torch":
        raise RuntimeError("the native library was built and does not load")


def native_variant() -> str:
    """Return which instruction set's kernels a new process loads; "torch" where there are none."""
    code = "from unisim_blender.core import native; print(native.variant())"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()
