"""What a sequence is rendered from: drive, sensors, settings, and the digest that says whether a finished frame still holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from ..render.captures import CaptureStates
from ..sensors.frames import CameraFrame, LidarFrame
from ..world.captures import Capture, Moment
from ..world.drive import Drive


class CaptureRenderer(Protocol):
    """What renders one sensor's capture."""

    def image(self, capture: Capture, passes: tuple[str, ...] = ("rgb",), width: int | None = None) -> CameraFrame:
        """One image with the passes asked for."""
        ...

    def sweep(self, capture: Capture) -> LidarFrame:
        """One sweep."""
        ...


@dataclass(frozen=True)
class SequenceSettings:
    """How captures are rendered; which they are is given apart, for it changes no capture's content."""

    cameras: tuple[str, ...]
    lidars: tuple[str, ...]
    passes: tuple[str, ...] = ("rgb",)
    formats: tuple[str, ...] = ("png", "exr", "ply", "npz", "labels")
    width: int | None = None
    quality: str = "balanced"
    device: str = "cpu"
    draw: int | None = None
    """Seed of the draw that decides which beams return; None takes those with a probability of half or more."""
    contact_shadows: bool = False
    max_error: tuple[str, ...] = ()
    """Bounds that every frame is to keep; ``quality`` is then for the sensors that none of them is for."""
    renderer: str = "neural"


@dataclass(frozen=True)
class RenderPlan:
    """A sequence to render: the ``moments`` of a drive.

    ``make_renderer`` is called once in every process and must pickle; ``scenes`` are the trained scenes' and meshes' hashes by
    the name that appearances have for them ("" is the drive's own), part of what decides whether a capture is up to date, as is
    ``environment``: machine, instruction set, libraries that compute; ``captures`` says what of the world each capture depends
    on; ``about`` is what the manifest says besides (names and hashes, no paths, so that it is the same wherever things lie).
    """

    drive: Drive
    moments: tuple[Moment, ...]
    settings: SequenceSettings
    make_renderer: Callable[[], CaptureRenderer]
    scenes: dict[str, str]
    environment: dict[str, str]
    about: dict[str, Any]
    captures: CaptureStates

    @property
    def frames(self) -> tuple[int, ...]:
        """The frames of the log among the moments."""
        return tuple(moment.frame for moment in self.moments if moment.frame is not None)

    def moment_of_frame(self, frame: int) -> Moment:
        """Return the captures that a frame of the log has, whether it is to be rendered or not."""
        return Moment.of_frame(self.drive, frame, self.settings.cameras, self.settings.lidars)
