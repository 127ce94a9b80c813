"""What is converted: a recorded drive in any layout, or a folder that `unisim render` wrote; and a digest of it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from ..data.log import Log
from ..data.log_digest import log_digest
from ..errors import LogError
from ..formats.readers import open_log
from ..formats.rendered import RenderedLog, is_rendered
from ..json_file import json_bytes
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
