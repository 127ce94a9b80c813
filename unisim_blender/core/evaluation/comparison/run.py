"""A comparison from a log to its table. Everything that takes long is kept in the folder: a run that was cut off goes
on where it was, and one that asks for more methods makes the table grow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...data.log import Log, extras_of
from ...errors import LogError, UnisimError, short
from ...files import holds_out, write_file
from ...formats.readers import drive_in, open_log
from ...json_file import Node, json_bytes, read_json
from ...prepare.selection import camera_ahead, check_names
from ...render.code_identity import code_identity
from ..ground_truth import known_log
from ..perceptual import Inception
from ..recorded_runs import Progress, perceptual_metric
from ..tracklets import disturbance_taken_back
from .measure import Case, ComparisonContext, cases_of, measured
from .methods import METHODS, CompareOptions, methods_named
from .page import comparison_markdown, page, tables_of
from .renderers import MethodRenderer, make_renderer

ROWS = "comparison.json"


@holds_out
def compare(
    log_path: Path, out: Path, options: CompareOptions, posed: Callable[[Log], Log],
    say: Callable[[str], object], progress: Progress, quiet: bool,
) -> str:  # fmt: skip
    """Make and measure every method that is wished for, and write comparison.json, comparison.md and index.html to
    ``out`` after each; the Markdown. Methods that an earlier run measured there stay in the table.
    ``posed`` returns a log with the poses that are asked for; a street's are known, and stay. Raises `UnisimError`."""
    methods = methods_named(options.methods)
    log, known = open_log(log_path), known_log(drive_in(log_path))
    log = posed(log) if known is None else log
    if not options.cameras:
        ahead = camera_ahead(log)
        if ahead is None:
            raise LogError(f"{log_path}: has no images to compare")
        options = replace(options, cameras=(ahead,))
    check_names("camera", options.cameras, [c for c in log.drive.cameras if log.image_frames(c)])
    inception = None if options.fid is None else Inception(options.fid)
    context = ComparisonContext(log, known, out, options, perceptual_metric(options.lpips), inception)
    cases = cases_of(log, context.known, out, options)
    about = _about(context, cases)
    rows = _earlier(out / ROWS, about)
    for name, method in methods.items():
        say(f"{method.title}: making it")
        rendering = make_renderer(name, method, log, out / "scenes" / name, options, quiet)
        row = {
            "title": method.title,
            "made": rendering.about or rows.get(name, {}).get("made", {}),
            **_boxes(rendering, log),
        }
        for case in cases:
            row[case.name] = measured(context, name, rendering, case, progress)
        rows[name] = row
        text = _write(out, log, about, cases, options, {n: rows[n] for n in METHODS if n in rows})
    return text


def _boxes(method: MethodRenderer, log: Log) -> dict[str, Any]:
    """How much of a disturbance was taken back, where the scene was trained on one."""
    noise = None if method.header is None else disturbance_taken_back(method.header, log.drive)
    return {} if noise is None else {"tracklets": noise}


def _about(context: ComparisonContext, cases: list[Case]) -> dict[str, Any]:
    """Return the settings that all rows of a table have in common."""
    options = context.options
    return {
        "log": context.log.drive.name,
        # streets of one seed have one name, whoever drew them
        "street": None if context.known is None else context.known.recipe,
        "cameras": list(options.cameras),
        "frames": options.frames,
        "width": options.width,
        "budget": f"{options.iterations} steps" if options.iterations else f"{options.minutes:g} minutes",
        "quality": options.quality,
        "disturb": None if options.disturb is None else list(options.disturb),
        "poses": extras_of(context.log).poses,
        "cases": {case.name: {"frames": list(case.frames), "moves_view": case.moves_view} for case in cases},
    }


def _earlier(path: Path, about: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Rows that an earlier run measured. UnisimError where it compared something else."""
    if not path.is_file():
        return {}
    document = Node(read_json(path, UnisimError), f"{path}: ", UnisimError)
    before, rows = document.key("about").object(), document.key("rows").object()
    for row in document.key("rows").members():
        row[1].key("title").text()
    before.setdefault("cases", before.get("parts"))  # its former name
    before.setdefault("poses", "log")
    for name, value in about.items():
        if before.get(name) != value:
            raise UnisimError(
                f"{path}: was measured with {name} {short(before.get(name))}, not {short(value)}: give another folder with --out"
            )
    return {name: row for name, row in rows.items() if name in METHODS}


def _write(
    out: Path,
    log: Log,
    about: dict[str, Any],
    cases: list[Case],
    options: CompareOptions,
    rows: dict[str, dict[str, Any]],
) -> str:
    title = f"Methods on {log.drive.name}"
    noise = "" if options.disturb is None else ", boxes disturbed by {:g} m and {:g} degrees".format(*options.disturb)
    words = (
        f"Learnt from frames {options.frames} of {', '.join(options.cameras)}, {options.width} pixels wide, {about['budget']} of "
        f"training each{noise}; rendered at quality {options.quality}. PSNR over all pixels of a frame, frames averaged; inside "
        "regions over all their pixels. Bold: the best of a column. Cost: dB below the replay of the same pixels."
    )
    tables = tables_of({case.name: case.moves_view for case in cases})
    text = comparison_markdown(title, words, tables, rows)
    write_file(out / ROWS, json_bytes({"about": about, "code": code_identity(), "rows": rows}))
    write_file(out / "comparison.md", text.encode())
    write_file(out / "index.html", page(out, title, words, tables, rows, cases, options.cameras).encode())
    return text
