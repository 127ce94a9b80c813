"""Optional packages in the extension's own folder, one folder each: put there by pip when a user agrees, and removed."""

from __future__ import annotations

import importlib
import importlib.util
import shutil
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.errors import UnisimError
from ..editing.texts import translatable
from ..translations import message
from . import client, interpreters
from .tasks import Task


@dataclass(frozen=True)
class OptionalPackage:
    """What pip is asked for in place of the package's own list, which names what Blender has, torch too. ``module`` is
    there once it is installed; ``size_mb`` is about what is downloaded."""

    name: str
    module: str
    use: str
    size_mb: int
    requirements: tuple[str, ...]

    @property
    def folder(self) -> Path:
        """Where it lies once it is installed."""
        return interpreters.PACKAGES / self.name

    @property
    def installed(self) -> bool:
        """Whether it is in the extension's folder."""
        return self.folder.is_dir()

    @property
    def available(self) -> bool:
        """Whether Blender's Python has it, from wherever."""
        return importlib.util.find_spec(self.module) is not None


NCORE = (
    "nvidia-ncore>=19.8", "dataclasses-json", "marshmallow<4", "typing-inspect", "typing-extensions", "mypy-extensions",
    "zarr<3", "asciitree", "numcodecs<0.16", "fasteners", "deprecated", "wrapt", "cbor2", "universal-pathlib",
    "pathlib-abc", "packaging", "scipy",
)  # fmt: skip
PYARROW = "pyarrow<26" if np.lib.NumpyVersion(np.__version__) < "2.0.0" else "pyarrow"
"""From 26 on it needs numpy 2."""
PACKAGES = {
    package.name: package
    for package in (
        OptionalPackage("pyarrow", "pyarrow", translatable("Logs of Argoverse 2 and Waymo Open"), 50, (PYARROW,)),
        OptionalPackage("nvidia-ncore", "ncore", translatable("Logs of NVIDIA NCore"), 45, NCORE),
        OptionalPackage("small_gicp", "small_gicp", translatable("KITTI logs without poses"), 1, ("small_gicp",)),
        OptionalPackage("imageio-ffmpeg", "imageio_ffmpeg", translatable("Videos"), 70, ("imageio-ffmpeg",)),
    )
}
"""Those that a window can use, by the names that errors have for them."""


def look_into_folders() -> None:
    """Let Blender's Python look into the folders of installed packages, after all others."""
    sys.path[:] = [place for place in sys.path if interpreters.PACKAGES not in Path(place).parents]
    sys.path += map(str, interpreters.package_folders())
    importlib.invalidate_caches()


@dataclass
class PackageTask(Task):
    """The installation of a package. ``folder`` is new and holds it until it is whole."""

    title = translatable("Installation")
    of_scene = False
    hears = True
    package: OptionalPackage = PACKAGES["pyarrow"]
    megabytes: tuple[float, float] = (0.0, 0.0)
    """Downloaded of the file at hand, and its size."""

    @property
    def done(self) -> float:
        """Fraction of the download."""
        done, total = self.megabytes
        return done / total if total else 0.0

    def _hear(self, lines: Iterable[bytes] | None) -> None:
        """Take the lines of pip: "Progress 1234 of 5678", in bytes, and what else it does."""
        for line in lines or ():
            match line.split():
                case [b"Progress", done, b"of", total]:
                    self.megabytes = int(done) / 1e6, int(total) / 1e6

    def text(self) -> str:
        name, (done, total) = self.package.name, self.megabytes
        if self.running:
            return message(
                "{package}: {done:.0f} of {total:.0f} MB", package=name, done=done, total=total or self.package.size_mb
            )
        if self.cancelled:
            return message("{package} is not installed: cancelled", package=name)
        return self.problem or message("{package} is installed", package=name)

    def finish(self) -> None:
        look_into_folders()
        client.close()

    @property
    def problem(self) -> str:
        """Why it could not be installed; pip's last errors are its reasons."""
        if not super().problem:
            return ""
        if any("Retrying" in line for line in self.words):
            why = message("the package index cannot be reached")
        else:
            errors = [line.removeprefix("ERROR: ") for line in self.words if line.startswith("ERROR: ")]
            why = " ".join(errors) or super().problem
        return message("{package} could not be installed: {why}", package=self.package.name, why=why)

    def _do(self) -> int:
        options = "--no-deps --only-binary :all: --no-binary asciitree --retries 2 --no-input --progress-bar raw"
        arguments = ["install", *options.split(), "--target", str(self.folder), *self.package.requirements]
        try:
            code = self._execute(interpreters.command(sys.executable, "pip", *arguments))
            if code == 0 and not self.cancelled:
                shutil.rmtree(self.package.folder, ignore_errors=True)
                self.folder.rename(self.package.folder)
        finally:
            shutil.rmtree(self.folder, ignore_errors=True)
        return code


def remove(package: OptionalPackage) -> None:
    """Delete a package's folder. Raises `UnisimError`."""
    client.close()  # the renderer may have loaded it
    try:
        shutil.rmtree(package.folder)
    except OSError as fault:
        raise UnisimError(f"{package.folder}: cannot be deleted: {fault.strerror}") from fault
    look_into_folders()


register = look_into_folders
