"""Exceptions that core raises when an input is at fault: one sentence that names the file and the value."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


class UnisimError(Exception):
    """Bad input or a failed resource. The message is one clear sentence; the command line prints it
    and exits with 1. ``remedy`` is what mends it, for a window that offers that as a button: the name by which pip knows an
    optional package, "interpreter" or "log"; "" where nothing does."""

    remedy = ""

    def __init__(self, *parts: object, remedy: str = "") -> None:
        super().__init__(*parts)
        self.remedy = remedy or self.remedy


class LogError(UnisimError):
    """A recorded drive that cannot be read."""


class SceneError(UnisimError):
    """A trained scene that cannot be loaded or does not fit."""


class ScenarioError(UnisimError):
    """A scenario that is not valid or does not fit its log."""


class SimulationError(UnisimError):
    """A state, an action or a parameter of a simulation that is not valid."""


class OutputError(UnisimError):
    """Output that cannot be written."""


@contextmanager
def refused(path: object, what: str, kind: type[UnisimError]) -> Iterator[None]:
    """Raise an error of a kind where the system refuses what is done within, "PATH: cannot be written: No space left on
    device", or where a text is not UTF-8."""
    try:
        yield
    except OSError as error:
        raise kind(f"{path}: cannot be {what}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise kind(f"{path}: is not UTF-8 text (byte {error.start})") from error


MAX_LETTERS = 300


def in_a_line(fault: Exception) -> str:
    """Return a library's message about a broken file in one line of at most MOST_LETTERS letters."""
    text = " ".join(str(fault).split()) or type(fault).__name__
    return text if len(text) <= MAX_LETTERS else f"{text[:MAX_LETTERS]} …"


def short(value: object) -> str:
    """A value of a file as a sentence names it: its end is left out where it is long."""
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


EXTRA = ".[torch]"
NCORE_MODULES = ("ncore", "zarr", "numcodecs", "cbor2", "upath", "dataclasses_json")
OPTIONAL = {
    **dict.fromkeys(("torch", "safetensors", "scipy", "skimage"), EXTRA),
    **dict.fromkeys(NCORE_MODULES, ".[ncore]"),
    "bpy": ".[blender]",
    "pyarrow": ".[parquet]",
    "imageio_ffmpeg": "imageio-ffmpeg",
    "small_gicp": ".[registration]",
    "gymnasium": ".[gym]",
    **dict.fromkeys(("fsspec", "jsonpointer"), ".[batch]"),
    **dict.fromkeys(("carla_driver_interface", "google", "grpc"), ".[alpasim]"),
    **dict.fromkeys(("mcap", "mcap_protobuf", "foxglove_schemas_protobuf", "zstandard"), ".[mcap]"),
    "ray": ".[ray]",
    "rosbags": ".[rosbag]",
    "scenariogeneration": ".[openscenario]",
}
"""Packages that rendering on a CPU does without, and what pip installs to bring them. "." is the package itself, which is
in no index: the folder of its sources."""


DISTRIBUTIONS = {
    **dict.fromkeys(NCORE_MODULES, "nvidia-ncore"),
    "imageio_ffmpeg": "imageio-ffmpeg",
    "skimage": "scikit-image",
}
"""Names by which pip knows packages whose modules have other names."""
IN_BLENDER = ("pyarrow", "nvidia-ncore", "small_gicp", "imageio-ffmpeg")
"""Packages, as pip knows them, that Blender's preferences install."""
_blenders_folder, _has_window = "", False


def install_into(folder: str, has_window: bool = False) -> None:
    """Have `what_is_missing` say how Blender gets a package: in its preferences where it ``has_window``, else by pip into a
    folder that Blender's Python looks into; "" as outside Blender."""
    global _blenders_folder, _has_window
    _blenders_folder, _has_window = folder, has_window


def remedy_of(error: ImportError) -> str:
    """Return the `UnisimError.remedy` of a package that is not installed."""
    name = (error.name or "").partition(".")[0]
    if not _has_window or not isinstance(error, ModuleNotFoundError):
        return ""
    package = DISTRIBUTIONS.get(name, name)
    return "interpreter" if OPTIONAL.get(name) == EXTRA else package if package in IN_BLENDER else ""


def what_is_missing(error: ImportError) -> str:
    """One sentence on an optional package that is not installed, or is and cannot be imported; "" where it is none of those."""
    name = (error.name or "").partition(".")[0]
    if name not in OPTIONAL:
        return ""
    if not isinstance(error, ModuleNotFoundError):
        return f"this needs {name}, which {sys.executable} cannot import; is it another Python's? ({in_a_line(error)})"
    if _blenders_folder and OPTIONAL[name] != EXTRA:
        lacking = f"this needs {name}, which Blender's Python does not have: "
        if _has_window and DISTRIBUTIONS.get(name, name) in IN_BLENDER:
            return f"{lacking}install it in Preferences > Add-ons > UniSim"
        command = f"'{sys.executable}' -m pip install --target '{_blenders_folder}' {DISTRIBUTIONS.get(name, name)}"
        return f"{lacking}run {command} and start Blender again"
    what = OPTIONAL[name]
    where = " in the folder of unisim_blender's sources" if what.startswith(".") else ""
    return f"this needs {name}, which {sys.executable} does not have: pip install '{what}'{where}"
