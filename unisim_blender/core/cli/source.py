"""Arguments that name what is read: by a path or a URL."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ..remote.requests import is_url


class SourceParam(click.Path):
    """A path, or the text of a URL."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """See `click.Path.convert`."""
        return value if is_url(value) else super().convert(value, param, ctx)
