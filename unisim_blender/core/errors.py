"""What core raises when an input is at fault: one sentence that names the file and the value."""

from __future__ import annotations


class UnisimError(Exception):
    """Bad input or a failed resource. The message is one clear sentence; the command line prints it and exits with 1."""


class LogError(UnisimError):
    """A recorded drive that cannot be read."""


class SceneError(UnisimError):
    """A trained scene that cannot be loaded or does not fit."""


class ScenarioError(UnisimError):
    """A scenario that is not valid or does not fit its log."""


class OutputError(UnisimError):
    """Output that cannot be written."""
