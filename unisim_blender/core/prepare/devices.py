"""Devices by the names that the command line has for them."""

from __future__ import annotations


def pick_device(name: str) -> str:
    """Return a device by its name; "auto" is the best there is here: the CPU, where torch is not installed."""
    if name != "auto":
        return name
    try:
        import torch
    except ModuleNotFoundError:
        return "cpu"
    return "cuda" if torch.cuda.is_available() else "mps" if torch.backends.mps.is_available() else "cpu"
