"""A scenario document, member by member as it stands in the file; None is a member that is not there.

Units are the document's own: metres, seconds, degrees. `docs/reference/scenario.md` says what each edit does.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from ..remote.copies import local_path
from ..remote.requests import is_url
from ..sensors.frames import CAMERA_PASSES
from .edit import Edit
from .json_schema import FRAME, PATH, TEXT, FilePath, PixelCount, Schema, SchemaOf, object_of, ref
from .light import LightSpec
from .motion.placement import BoxSpec
from .sensors.document import Sensors
from .simulation import SimulationSpec
from .time_range import Outside, Times
from .weather import WeatherSpec

RECORDED = "recorded"
"""The ``scene`` of a scenario that needs no trained scene."""


@dataclass(frozen=True)
class FrameRange:
    """Frames from ``start`` (the first) up to but without ``stop`` (past the last)."""

    start: int | None = None
    stop: int | None = None
    step: Annotated[int, SchemaOf({"type": "integer", "minimum": 1})] | None = None


STREET: Schema = {
    "type": "object",
    "additionalProperties": {"type": ["number", "string"]},
    "propertyNames": {"pattern": "^[a-z][a-z0-9-]*$"},
    "description": "Options of `unisim synth` that make the log.",
}


@dataclass(frozen=True)
class StreetLog:
    """A street's folder, and the options of `unisim synth` that make it."""

    path: FilePath
    street: Annotated[dict[str, float | str], SchemaOf(STREET)]


FRAME_FORMATS = {
    "png": "images, sRGB",
    "exr": "images with all passes, linear",
    "ply": "returns of sweeps, as points",
    "npz": "returns of sweeps, as NumPy arrays",
    "labels": "boxes of actors, as JSON",
}
"""Formats of frames, which are all written by default, and what they are."""
SEQUENCE_FORMATS = {
    "pandaset": "a log in PandaSet's layout",
    "video": "a film of every camera",
    "mcap": "one MCAP file that Foxglove and Rerun open",
    "rosbag": "a ROS 2 bag, which needs no ROS to be written",
    "coco": "COCO's annotations of the images: boxes of actors",
}
"""Formats that are made of a whole sequence, after its frames, and what they are."""


def _names(choices: Iterable[str]) -> Schema:
    return {"type": "array", "items": {"enum": list(choices)}, "uniqueItems": True}


@dataclass(frozen=True)
class Outputs:
    """Settings of the outputs that are written; None leaves the choice to the renderer."""

    passes: Annotated[tuple[str, ...], SchemaOf({**_names(CAMERA_PASSES), "minItems": 1})] | None = None
    formats: Annotated[tuple[str, ...], SchemaOf(_names([*FRAME_FORMATS, *SEQUENCE_FORMATS]))] | None = None
    width: PixelCount | None = None
    quality: Annotated[str, SchemaOf({"enum": ["fast", "balanced", "fine", "reference"]})] | None = None
    contact_shadows: bool | None = None
    fill: str | None = None
    detail: bool | None = None


@dataclass(frozen=True)
class Scenario:
    """A scenario document. ``path`` is its file, which the paths in it are relative to."""

    name: str
    log: str | StreetLog
    description: str | None = None
    scene: str | None = None
    frames: tuple[int, ...] | FrameRange | None = None
    times: Times | None = None
    outside: str | Outside | None = None
    sensors: Sensors | None = None
    boxes: dict[str, BoxSpec] | None = None
    edits: tuple[Edit, ...] = ()
    weather: WeatherSpec | None = None
    light: LightSpec | None = None
    outputs: Outputs | None = None
    simulation: SimulationSpec | None = None
    path: Path = field(default=Path("scenario.json"), compare=False)

    def resolve(self, name: str) -> Path:
        """Return a path of the document as an absolute path; of a URL, the path of a local copy. Raises
        `InputError`."""
        if is_url(name):
            return local_path(name)
        return (self.path.parent / name).resolve()

    @property
    def log_path(self) -> Path:
        return self.resolve(self.log_name)

    @property
    def log_name(self) -> str:
        """Name of the log's folder in the document: a path or a URL."""
        return self.log if isinstance(self.log, str) else self.log.path

    @property
    def scene_path(self) -> Path | None:
        """The trained scene's folder; None where the scenario needs none."""
        return None if self.scene in (None, RECORDED) else self.resolve(str(self.scene))


DEFS: dict[str, Schema] = {
    "street_log": object_of(StreetLog),
    "frame_range": object_of(FrameRange, "From start (the first) up to but without stop (past the last)."),
    "outputs": object_of(Outputs),
}
MEMBERS: dict[str, Schema] = {
    "name": TEXT,
    "description": {"type": "string"},
    "log": {
        "description": "The log's folder, or a street's folder with the recipe to make it.",
        "if": {"type": "object"},
        "then": ref("street_log"),
        "else": PATH,
    },
    "scene": {**PATH, "description": 'The trained scene\'s folder; "recorded" or nothing where none is needed.'},
    "frames": {
        "description": "Frames to render; all where this is missing.",
        "if": {"type": "object"},
        "then": ref("frame_range"),
        "else": {"type": "array", "items": FRAME, "minItems": 1, "uniqueItems": True},
    },
    "times": ref("times"),
    "outside": ref("outside_recording"),
    "sensors": ref("sensors"),
    "boxes": {
        "type": "object",
        "propertyNames": TEXT,
        "additionalProperties": ref("box"),
        "description": "Boxes of space by id, for the edits of static items.",
    },
    "edits": {"type": "array", "items": ref("edit"), "description": "Applied in order."},
    "weather": ref("weather"),
    "light": ref("light"),
    "outputs": ref("outputs"),
    "simulation": ref("simulation"),
}
"""The JSON Schema of each member of `Scenario`, beside ``format`` and ``version``."""
