"""Versions, devices and memory of an interpreter that renders or trains."""

from __future__ import annotations

import os
import platform
import sys
import warnings
from importlib import import_module, metadata, util
from typing import Any

from .. import cuda_driver
from ..native import variant
from ..scenes.recipe import environment, pick_device

TRAINING_PACKAGES = ("torch", "scipy", "safetensors")
"""Packages that training needs in addition to those of rendering."""


def about() -> dict[str, Any]:
    """Return versions, devices and memory. Raises ImportError naming a package that rendering needs and
    that is missing."""
    for name in ("click", "jsonschema", "OpenEXR", "PIL", "plyfile", "tqdm", "trimesh"):
        import_module(name)
    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        best = pick_device("auto")
    environment(best)
    lacking = [name for name in TRAINING_PACKAGES if util.find_spec(name) is None]
    return {
        "python": platform.python_version(),
        "executable": sys.executable,
        "torch": "" if "torch" in lacking else metadata.version("torch"),
        "training_lacks": lacking,
        "devices": list(dict.fromkeys((best, "cpu"))),
        "memory_bytes": _device_bytes() if best == "cuda" else _memory_bytes(),
        "kernels": variant(),
        "warnings": [str(each.message) for each in noted],
    }


def _device_bytes() -> int:
    if not cuda_driver.missing():
        return cuda_driver.gpu(0).memory_bytes()[1]
    import torch

    return int(torch.cuda.get_device_properties(0).total_memory)


def _memory_bytes() -> int:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):  # not on Windows
        return 0
