"""What a stage is told, and where it leaves what it found."""

from __future__ import annotations

import json
import os
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
CAMERA = "front_camera"


@dataclass(frozen=True)
class Settings:
    """Of a whole run, and the ``limit_s`` that a stage has. ``work`` takes the street and the scenes, ``out``
    what is kept."""

    device: str
    size: tuple[int, int]
    frames: int
    seconds: float
    samples: int
    rounds: int
    work: str
    out: str
    limit_s: float = 600.0

    def to_json(self) -> str:
        """Return the settings as a JSON document."""
        return json.dumps(asdict(self))

    @staticmethod
    def from_json(text: str) -> Settings:
        """Return the settings of `to_json`."""
        values = json.loads(text)
        return replace(Settings(**values), size=tuple(values["size"]))


class Findings:
    """A stage's findings: a JSON file that is written anew, as a whole, whenever something is noted."""

    def __init__(self, file: Path, limit_s: float) -> None:
        self.file, self.until = file, time.monotonic() + limit_s
        self.values: dict[str, Any] = {}

    def left_s(self) -> float:
        """Return how many seconds the stage has left."""
        return self.until - time.monotonic()

    def note(self, **values: Any) -> None:
        """Note values by name, at once in the file."""
        self.values |= values
        write_json(self.file, self.values)

    def failed(self, what: str, trace: str) -> None:
        """Note the traceback of something that failed, beside which the rest goes on."""
        self.note(errors={**self.values.get("errors", {}), what: trace})


def write_json(file: Path, values: Any) -> None:
    """Write a JSON file, whole or not at all."""
    temporary = file.with_name(f".{file.name}.part")
    temporary.write_text(json.dumps(values, indent=1, default=str), encoding="utf-8")
    os.replace(temporary, file)
