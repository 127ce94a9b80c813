"""What a worker's machine must share with the one that planned a batch, so that both render the same bytes."""

from __future__ import annotations

import socket
from collections.abc import Iterable, Mapping
from pathlib import Path

from ..errors import UnisimError
from ..native import VARIANT_VARIABLE
from ..prepare.backends import environment


def check_environment(planned: Mapping[str, str], device: str, scenes: Iterable[Path] = ()) -> None:
    """Check that trained scenes in these folders are rendered here, on a device, as where a batch was planned, whose
    `environment` this was. Raises `UnisimError`, which names this machine and what differs."""
    here = environment(device, scenes)
    if told := difference(planned, here):
        raise UnisimError(
            f"{socket.gethostname()}: renders other bytes than the machine that planned the batch: its {told}; "
            "install the same versions on all machines, and have all use one instruction set, by "
            f"{VARIANT_VARIABLE}, or of torch by ATEN_CPU_CAPABILITY"
        )


def difference(planned: Mapping[str, str], here: Mapping[str, str]) -> str:
    """Say in which member two environments differ; "" where they are equal."""
    for name in sorted(planned.keys() | here.keys()):
        if planned.get(name) != here.get(name):
            return f"{name} is {here.get(name)}, not {planned.get(name)}"
    return ""
