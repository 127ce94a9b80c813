"""A scenario's edits: pure functions that turn one drive into another."""

from .apply import apply_scenario

__all__ = ["apply_scenario"]
