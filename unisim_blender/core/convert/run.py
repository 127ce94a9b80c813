"""Converts a log: writes the parts that are not there yet, and names the folder when all of it is there.

All is written to a hidden folder beside ``out``, which is renamed to it at the end. An interrupted conversion leaves that folder;
the same conversion, begun again, goes on with it. `conversion.json` says what was converted, and how.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..data.log import Log
from ..data.log_digest import log_digest
from ..errors import LogError, OutputError
from ..files import hold_folder, remove_partial_files, write_file
from ..formats.common.writer import SCRATCH, LogWriter, WritePlan
from ..formats.readers import open_log
from ..formats.rendered import RenderedLog, is_rendered
from ..json_file import Node, json_bytes, read_json
from ..world.drive_json import drive_to_json


@dataclass(frozen=True)
class ConvertSource:
    """A drive to convert; ``digest`` is the same wherever its files lie, and another one when they change."""

    log: Log
    digest: str


def open_source(path: Path | str) -> ConvertSource:
    """Open a log or a rendered folder. Raises `LogError`."""
    path = Path(path)
    if not path.exists():
        raise LogError(f"{path}: there is no such log, and nothing that was rendered")
    log: Log
    if is_rendered(path):
        log = rendered = RenderedLog(path)
        files = rendered.content
    else:
        log = open_log(path)
        files = log_digest(log)
    digest = hashlib.sha256(files.encode())
    # of a log that is named by one of its files, the other files' poses and boxes
    digest.update(json_bytes(drive_to_json(log.drive)))
    return ConvertSource(log, digest.hexdigest())


STATE = "conversion.json"
FORMAT, VERSION = "unisim-conversion", 1


@dataclass(frozen=True)
class Converted:
    """Result of a conversion: captures written by this run, those that were there, the layout's ``losses``, and the
    path that `open_log` opens. ``was_there``: an earlier run had finished it."""

    written: int
    kept: int
    losses: tuple[str, ...]
    opens: Path
    was_there: bool = False


def unfinished_folder(out: Path) -> Path:
    """Return where a conversion to ``out`` is written until it is finished."""
    return out.with_name(f".{out.name}.unfinished")


def convert(
    source: ConvertSource,
    writer: LogWriter,
    out: Path,
    on_start: Callable[[int, tuple[str, ...]], None] = lambda captures, losses: None,
    on_kept: Callable[[int], None] = lambda captures: None,
    on_capture: Callable[[], None] = lambda: None,
) -> Converted:
    """Write a source's drive as a log in the folder ``out``.

    ``on_start`` is called once with the number of captures and what the layout loses, ``on_kept`` with the captures of each part
    that was there, ``on_capture`` after each that is written. A conversion that was finished before, of the same source, is left
    as it is. Raises `OutputError`, `LogError`; what was written stays, to go on from.
    """
    out = Path(os.path.abspath(out))
    about = {
        "format": FORMAT,
        "version": VERSION,
        "to": writer.name,
        "writer_version": writer.version,
        "source": {"name": source.log.drive.name, "digest": source.digest},
    }
    if out.exists():
        if not out.is_dir():
            raise OutputError(f"{out}: is no folder")
        if any(out.iterdir()):
            _check_same(out, about)
            finished = Node(read_json(out / STATE, OutputError), f"{out / STATE}: ", OutputError)
            losses = tuple(node.text() for node in finished.key("losses").elements())
            captures, opens = finished.key("captures").integer(at_least=1), finished.key("opens").text()
            return Converted(0, captures, losses, out / opens, was_there=True)
    with hold_folder(unfinished_folder(out)):
        return _convert(source, writer, out, about, (on_start, on_kept, on_capture))


def _convert(
    source: ConvertSource,
    writer: LogWriter,
    out: Path,
    about: dict[str, Any],
    on: tuple[Callable[[int, tuple[str, ...]], None], Callable[[int], None], Callable[[], None]],
) -> Converted:
    """Write what is not there yet into the unfinished folder, and rename it to ``out``."""
    folder, (on_start, on_kept, on_capture) = unfinished_folder(out), on
    if begun := folder.is_dir() and any(folder.iterdir()):
        _check_same(folder, about)
        remove_partial_files(folder)
    try:
        plan = writer.plan(source.log, folder)
        captures = sum(part.captures for part in plan.parts)
        if not captures:
            raise OutputError(f"{source.log.path}: has neither images nor sweeps to convert")
    except BaseException:
        if not begun:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    said = {"captures": captures, "losses": list(plan.losses), "opens": plan.opens}
    write_file(folder / STATE, json_bytes({**about, **said}))
    on_start(captures, plan.losses)
    written, kept = _write_parts(plan, folder, on_kept, on_capture)
    plan.finish()
    shutil.rmtree(folder / SCRATCH, ignore_errors=True)
    try:
        if out.is_dir():
            out.rmdir()
        os.replace(folder, out)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written: {error.strerror}") from error
    return Converted(written, kept, plan.losses, out / plan.opens)


def _write_parts(
    plan: WritePlan, folder: Path, on_kept: Callable[[int], None], on_capture: Callable[[], None]
) -> tuple[int, int]:
    written = kept = 0
    for part in plan.parts:
        if all((folder / name).is_file() for name in part.files):
            kept += part.captures
            on_kept(part.captures)
        else:
            part.write(on_capture)
            written += part.captures
    return written, kept


def _state(folder: Path) -> dict[str, Any] | None:
    """Return the state of the conversion that a folder records; None where it records none."""
    try:
        state = json.loads((folder / STATE).read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    return state if isinstance(state, dict) and state.get("format") == FORMAT else None


def _check_same(folder: Path, about: dict[str, Any]) -> None:
    state = _state(folder)
    if state is None:
        raise OutputError(f"{folder}: is not empty, and holds no conversion; name another folder")
    if any(state.get(name) != value for name, value in about.items()):
        source = state.get("source")
        name = source.get("name") if isinstance(source, dict) else None
        raise OutputError(
            f"{folder}: holds another conversion, of {str(name)!r:.80} to {str(state.get('to'))!r:.20} or by another version; "
            "remove it, or name another folder"
        )
