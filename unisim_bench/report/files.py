"""A measurement's files: bench.json, bench.md, and images where matplotlib is installed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from unisim_blender.core.evaluation.recorded import finite
from unisim_blender.core.files import write_file
from unisim_blender.core.json_file import json_bytes

from ..cases import BenchmarkCase
from ..settings import Settings
from .metrics import metrics_of
from .tables import markdown


def document(
    cases: Sequence[BenchmarkCase],
    scene: str,
    settings: Settings,
    where: dict[str, object],
    left_out: Sequence[str],
    complete: bool,
) -> dict[str, Any]:
    """Everything that was measured, and where; ``left_out`` are sentences."""
    return {
        "scene": scene,
        "machine": where,
        "settings": asdict(settings),
        "left_out": list(left_out),
        "complete": complete,
        "metrics": metrics_of(cases),
    }


def write_report(out: Path, document: dict[str, Any]) -> list[Path]:
    """Write the files and give their paths. Raises `OutputError`; ModuleNotFoundError, after the others are written,
    where matplotlib is missing."""
    files = {"bench.json": json_bytes(finite(document)), "bench.md": markdown(document).encode()}
    for name, data in files.items():
        write_file(out / name, data)
    from .plots import images

    drawn = images(document["metrics"])
    for name, data in drawn.items():
        write_file(out / name, data)
    return [out / name for name in (*files, *drawn)]
