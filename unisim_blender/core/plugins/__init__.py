"""Parts that other packages bring: found by their entry points, and importing this package by its own name."""

from __future__ import annotations

from .entries import entries as entries
from .installed import load_installed as load_installed
