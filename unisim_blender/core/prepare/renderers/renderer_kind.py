"""What a renderer of the command line is: what it is made for, and the source that makes it in any process."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple, Protocol, TypeVar

from ...render.captures import CaptureStates
from ...render.tracers.surfels.build import Step
from ...scenes.scene import Scene
from ...sensors.error_bound import ErrorBound
from ...sequence.plan import CaptureRenderer
from ...world.drive import Drive


class RendererSpec(NamedTuple):
    """What a renderer is made for: a log's folder, a trained scene, those that actors were inserted from, the edited
    drive, settings, frames to learn from."""

    log: Path
    scene: Scene | None
    others: Mapping[str, Scene]
    drive: Drive
    quality: str
    device: str
    draw: int | None
    shadows: bool
    frames: tuple[int, ...] | None


class Maker(ABC):
    """Makes a renderer in any process, and pickles."""

    @abstractmethod
    def __call__(self) -> CaptureRenderer:
        """Make the renderer; what computes is imported here. Raises `UnisimError`."""

    def steps(self) -> Iterator[Step]:
        """What has to be made once before, step by step."""
        return iter(())


class Source(Maker):
    """Makes a renderer, and says what its frames depend on."""

    @abstractmethod
    def hashes(self) -> dict[str, str]:
        """Digests of the scenes that it renders, by `Appearance.scene`, "" for the drive's own."""

    @abstractmethod
    def captures(self) -> CaptureStates:
        """What of the world each capture depends on; the renderer sees the same."""

    def scenes(self) -> tuple[Scene, ...]:
        """The trained scenes that are rendered."""
        return ()

    def warnings(self, recorded: Drive, sweeps: bool) -> list[str]:
        """One sentence for each thing that comes out otherwise than the edits ask for."""
        return []

    def bounded(self, bounds: tuple[ErrorBound, ...]) -> Maker | None:
        """Return what makes the renderer that keeps its frames to bounds of their errors; None where there is none."""
        return None


class RendererKind(Protocol):
    """A renderer by its name. Those that are ``trained`` see the drive as their trained scene refined it."""

    @property
    def name(self) -> str:
        """What `unisim render --renderer` calls it."""
        ...

    @property
    def trained(self) -> bool:
        """Whether it needs a trained scene."""
        ...

    @property
    def about(self) -> str:
        """What it renders, in a few words for the command line's help."""
        ...

    def source(self, spec: RendererSpec) -> Source:
        """Return what makes the renderer. Raises `UnisimError`."""
        ...


RENDERERS: dict[str, RendererKind] = {}
"""The registered renderers by the name that `unisim render --renderer` has for them."""
Kind = TypeVar("Kind", bound=RendererKind)


def register(renderer: Kind) -> Kind:
    """Register a renderer: `unisim render --renderer` then takes its name. Returns it. Raises `ValueError` for a name
    that is taken."""
    if renderer.name in RENDERERS:
        raise ValueError(f"there is a renderer {renderer.name!r} already")
    RENDERERS[renderer.name] = renderer
    return renderer
