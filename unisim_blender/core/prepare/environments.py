"""What a worker's machine must share with the one that planned a render, so that both render the same bytes."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from ..errors import UnisimError
from ..native import VARIANT_VARIABLE
from ..render.code_identity import code_identity
from ..render.tracers.surfels.build import Step
from ..scenes.backends import environment
from ..scenes.scene import Scene
from ..sequence.plan import CaptureRenderer
from .renderers.renderer_kind import Maker


def check_code(planned: str) -> None:
    """Check that this machine's unisim_blender has the digest of the one that planned. Raises `UnisimError`."""
    if code_identity()["sha256"] != planned:
        raise UnisimError(
            f"{socket.gethostname()}: its unisim_blender is another one than that of the machine that planned this; "
            "install the same version on all machines"
        )


def check_environment(planned: Mapping[str, str], device: str, scenes: Sequence[Scene] = ()) -> None:
    """Check that trained scenes are rendered here, on a device, as where that was planned, whose
    `environment` this was. Raises `UnisimError`, which names this machine and what differs."""
    here = environment(device, scenes)
    if told := difference(planned, here):
        raise UnisimError(
            f"{socket.gethostname()}: renders other bytes than the machine that planned this: its {told}; "
            "install the same versions on all machines, and have all use one instruction set, by "
            f"{VARIANT_VARIABLE}, or of torch by ATEN_CPU_CAPABILITY"
        )


def difference(planned: Mapping[str, str], here: Mapping[str, str]) -> str:
    """Say in which member two environments differ; "" where they are equal."""
    for name in sorted(planned.keys() | here.keys()):
        if planned.get(name) != here.get(name):
            return f"{name} is {here.get(name)}, not {planned.get(name)}"
    return ""


@dataclass(frozen=True)
class CheckedMaker(Maker):
    """Makes what ``maker`` makes, where these ``scenes`` are rendered as on the machine that planned it: ``code`` was the digest
    of its code, ``planned`` its `environment`."""

    maker: Maker
    code: str
    planned: Mapping[str, str]
    device: str
    scenes: tuple[Scene, ...]

    def __call__(self) -> CaptureRenderer:
        """Make the renderer. Raises `UnisimError`, also where this machine renders other bytes."""
        check_code(self.code)
        check_environment(self.planned, self.device, self.scenes)
        return self.maker()

    def steps(self) -> Iterator[Step]:
        """See `Maker.steps`."""
        return self.maker.steps()
