"""What an interpreter has of what rendering needs."""

from __future__ import annotations

import os
import platform
import sys
from typing import Any

from ..native import variant
from ..prepare.renderers import pick_device


def about() -> dict[str, Any]:
    """Versions, devices, memory. Raises ImportError naming what is missing."""
    import click  # noqa: F401
    import OpenEXR  # noqa: F401
    import PIL  # noqa: F401
    import safetensors  # noqa: F401
    import scipy  # noqa: F401
    import torch

    best = pick_device("auto")
    memory = torch.cuda.get_device_properties(0).total_memory if best == "cuda" else _memory_bytes()
    return {
        "python": platform.python_version(),
        "executable": sys.executable,
        "torch": torch.__version__,
        "devices": list(dict.fromkeys((best, "cpu"))),
        "memory_bytes": memory,
        "kernels": variant(),
    }


def _memory_bytes() -> int:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):  # not on Windows
        return 0
