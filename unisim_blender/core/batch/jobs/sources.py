"""Files that jobs are read from: on this machine, or copies of what lies at URLs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import ScenarioError
from ...json_file import read_json
from ...prepare.scenario import named
from ...remote.copies import local_path
from ...remote.requests import beside, is_url
from ...scenario import scenario_from_json
from ...scenario.rebase import at_url
from ...scenario.types import Scenario


@dataclass(frozen=True)
class JobFile:
    """A file at ``path``, which is a copy of what lies at ``url`` where that is given. As text it is its name."""

    path: Path
    url: str | None = None

    @staticmethod
    def of(name: Path | str) -> JobFile:
        """Return the file of a path or a URL. Raises `InputError` where it cannot be fetched."""
        return JobFile(local_path(str(name)), str(name)) if is_url(name) else JobFile(Path(name))

    def __str__(self) -> str:
        return self.url or str(self.path)

    def beside(self, name: str) -> JobFile:
        """Return the file that this one means by a name."""
        if self.url is not None:
            return JobFile.of(beside(self.url, name))
        return JobFile.of(name) if is_url(name) else JobFile((self.path.parent / name).resolve())

    @contextmanager
    def named(self) -> Iterator[None]:
        """Within it, errors that name the copy name the URL."""
        with named(self.path, str(self)):
            yield

    def json(self) -> Any:
        """Return the file's JSON document. Raises `ScenarioError`."""
        with self.named():
            return read_json(self.path, ScenarioError)

    def scenario(self, document: Any) -> Scenario:
        """Return the checked scenario of a JSON value whose relative paths lie beside the file. Raises `ScenarioError`."""
        with self.named():
            scenario = scenario_from_json(document, self.path)
        return scenario if self.url is None else at_url(scenario, self.url)
