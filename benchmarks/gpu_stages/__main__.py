"""One stage: `python -m benchmarks.gpu_stages STAGE SETTINGS FILE`, where a stage of a preset is called NAME-PRESET."""

from __future__ import annotations

import importlib
import sys
import traceback
from pathlib import Path

from benchmarks.gpu_stages.settings import Findings, Settings

STAGES = {
    "machine": ("machine", "machine"),
    "native": ("machine", "build_native"),
    "street": ("street", "make_street"),
    "kernels": ("kernels", "compare_kernels"),
    "train": ("scenes", "train_scene"),
    "tracer": ("times", "time_tracer"),
    "times": ("times", "time_scene"),
    "profile": ("profiles", "profile_scene"),
}
"""Module and function of each."""


def main(name: str, settings: Settings, file: Path) -> int:
    """Run a stage and leave what it finds in a file; return 1 where it fails, or something in it did."""
    found = Findings(file, settings.limit_s)
    kind, _, preset = name.partition("-")
    module, function = STAGES[kind]
    try:
        found.note()
        getattr(importlib.import_module(f"benchmarks.gpu_stages.{module}"), function)(
            settings, found, *[preset] * bool(preset)
        )
    except Exception:  # noqa: BLE001 whatever it was, the next stage is worth its time
        found.note(error=traceback.format_exc())
    return int("error" in found.values or bool(found.values.get("errors")))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Settings.from_json(sys.argv[2]), Path(sys.argv[3])))
