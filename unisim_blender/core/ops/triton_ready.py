"""Whether Triton's kernels can be used for a tensor: there is a GPU, Triton is installed, and a first kernel ran."""

from __future__ import annotations

import functools
import importlib.util
import os
import warnings

from torch import Tensor


def ready(like: Tensor) -> bool:
    """Whether kernels take the place of torch's operations on tensors like this one. UNISIM_TRITON=0 says never."""
    return like.is_cuda and _works(str(like.device))


@functools.cache
def _works(device: str) -> bool:
    if os.environ.get("UNISIM_TRITON", "1") == "0" or importlib.util.find_spec("triton") is None:
        return False
    try:
        from .triton_probe import probe

        probe(device)
    except Exception as error:  # noqa: BLE001 whatever a compiler or a driver raises: torch's operations do as well
        why = (str(error).splitlines() or [type(error).__name__])[0]
        warnings.warn(f"Triton's kernels do not run on {device}, torch's own operations are used: {why}", stacklevel=2)
        return False
    return True
