"""Renderers by name, made from paths wherever they are needed: in this process or in a worker."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from .. import native
from ..data import open_log
from ..data.log import Log
from ..errors import ScenarioError
from ..files import sha256_of_file
from ..model.config import ModelConfig
from ..model.scene_file import HEADER_NAME, read_scene_header
from ..model.weights import weights_hash
from ..render.bounded import BoundedRenderer
from ..render.captures import CaptureStates
from ..render.drive_renderer import DriveRenderer
from ..render.quality import quality_named
from ..render.renderer import Renderer, reach_of
from ..render.tracer import Backend
from ..render.tracers.compiled.scene import CompiledScene
from ..render.tracers.compiled.support import not_taken
from ..render.tracers.compiled.tracer import CompiledBackend
from ..render.tracers.surfels.build import Step, finished
from ..render.tracers.surfels.cache import build_key, surfels_of
from ..render.tracers.surfels.model import LIDARSIM, PROXY, SurfelScene, SurfelSettings
from ..render.tracers.surfels.tracer import SurfelBackend
from ..render.tracers.warping.tracer import WarpBackend
from ..sensors.error_bound import ErrorBound
from ..world.drive import Drive
from ..world.replay import DriveStates, parked_boxes
from .scenes import other_scenes, stamp


def pick_device(name: str) -> str:
    """A device by its name; "auto" is the best there is here: the CPU, where torch is not installed."""
    if name != "auto":
        return name
    try:
        import torch
    except ModuleNotFoundError:
        return "cpu"
    return "cuda" if torch.cuda.is_available() else "mps" if torch.backends.mps.is_available() else "cpu"


def scene_paths(scene: Path, drive: Drive) -> tuple[Path, ...]:
    """Folders of all trained scenes that a drive is rendered with, its own first."""
    return scene, *map(Path, other_scenes(drive))


def scene_hash(path: Path) -> str:
    """One digest of a trained scene's two files."""
    parts = [sha256_of_file(path / HEADER_NAME), weights_hash(path)]
    return hashlib.sha256(" ".join(parts).encode()).hexdigest()


def scene_hashes(scene: Path, drive: Drive) -> dict[str, str]:
    """Digests of all scenes and meshes that a drive is rendered with, by the name that looks have for them."""
    others = {name: scene_hash(Path(name)) for name in other_scenes(drive)}
    return {"": scene_hash(scene), **others, **mesh_hashes(drive)}


def mesh_hashes(drive: Drive) -> dict[str, str]:
    """Digests of all meshes in a drive, by the name that looks have for them."""
    meshes = {actor.look.mesh for actor in drive.actors.values()} - {""}
    return {name: sha256_of_file(Path(name)) for name in sorted(meshes)}


def compiled(device: str, scenes: Iterable[Path] = ()) -> bool:
    """Whether rays are traced by the compiled kernels there: on the CPU, where they were built, if they take all the scenes."""
    return device == "cpu" and native.library() is not None and not any(_not_taken(stamp(scene)) for scene in scenes)


@lru_cache(maxsize=64)
def _not_taken(stamped: tuple[Any, ...]) -> str:
    """`not_taken` of the scene that a stamp is of: the header need not be read for every image of a view."""
    return not_taken(ModelConfig.from_dict(read_scene_header(stamped[0]).model))


def environment(device: str, scenes: Iterable[Path] = ()) -> dict[str, str]:
    """What else equal bytes depend on: machine, instruction set, libraries that compute. ModuleNotFoundError names the one that
    is not installed."""
    common = {"machine": platform.machine(), "device": device, "numpy": np.__version__}
    if compiled(device, scenes):
        return {**common, "kernels": str(native.ABI_VERSION), "instruction_set": native.variant()}
    import torch

    return {**common, "torch": torch.__version__, "instruction_set": torch.backends.cpu.get_cpu_capability()}


def make_backend(
    scene_path: Path,
    others: Iterable[str] = (),
    quality: str = "balanced",
    device: str = "cpu",
    kept: dict[object, Any] | None = None,
) -> Backend:
    """Load the scene in a folder onto a device, and by their folders those ``others`` that actors are inserted from.

    ``kept`` holds the scenes that an earlier call has loaded, and afterwards those of this one. Raises `SceneError`.
    """
    paths = {"": scene_path, **{name: Path(name) for name in others}}
    if compiled(device, paths.values()):
        scenes = _loaded(CompiledScene, paths, device, kept)
        return CompiledBackend(scenes.pop(""), quality_named(quality), scenes)
    from ..model.checkpoint import load_scene
    from ..render.tracers.torch.tracer import TorchBackend

    scenes = _loaded(partial(load_scene, device=device), paths, device, kept)
    return TorchBackend(scenes.pop(""), quality_named(quality), scenes)


def _loaded(
    load: Callable[[Path], Any], paths: Mapping[str, Path], device: str, kept: dict[object, Any] | None
) -> dict[str, Any]:
    """Return the scenes in folders, by the names that looks have for them."""
    before, now, loaded = kept or {}, {}, {}
    for name, path in paths.items():
        key = device, stamp(path)
        loaded[name] = now[key] = before.get(key) or load(path)
    if kept is not None:
        kept.clear()
        kept.update(now)
    return loaded


@dataclass(frozen=True)
class SceneSource:
    """Makes the neural renderer of a drive; pickles, and imports what computes when it is called."""

    scene: Path
    drive: Drive
    quality: str = "balanced"
    device: str = "cpu"
    draw: int | None = None
    shadows: bool = False

    def __call__(self) -> DriveRenderer:
        """Load the scene and those that actors were inserted from. Raises `SceneError`."""
        backend = make_backend(self.scene, other_scenes(self.drive), self.quality, self.device)
        return DriveRenderer(Renderer(backend, self.shadows), self.drive, self.draw)

    def hashes(self) -> dict[str, str]:
        """See `scene_hashes`."""
        return scene_hashes(self.scene, self.drive)

    def captures(self) -> CaptureStates:
        """See `Source.captures`."""
        return CaptureStates(DriveStates(self.drive, read_scene_header(self.scene).parked), reach_of(self.shadows))

    def steps(self) -> Iterator[Step]:
        """Nothing is to be made first."""
        return iter(())


@dataclass(frozen=True)
class BoundedSource:
    """The same of a renderer whose error is bounded."""

    source: SceneSource
    bounds: tuple[ErrorBound, ...]

    def __call__(self) -> BoundedRenderer:
        """Load what the source loads. Raises `SceneError`."""
        return BoundedRenderer(self.source(), self.bounds)

    def steps(self) -> Iterator[Step]:
        """See `SceneSource.steps`."""
        return self.source.steps()


METHODS = ("neural", "ngp", "nsg")
"""What scenes can be trained by, see `ModelConfig.method`."""
UNTRAINED: dict[str, SurfelSettings] = {"surfel": LIDARSIM, "warp": PROXY}
"""Renderers that need no trained scene, and the surfels that they have."""
UNTRAINED_DEFAULT = "surfel"
"""What renders a log without a trained scene where nobody names another."""


def untrained_backend(
    name: str, scene: SurfelScene, log: Log, frames: tuple[int, ...] | None = None, quality: str = "balanced"
) -> Backend:
    """What traces rays over a log's surfels, which were made of ``frames`` (all where None)."""
    if name == "warp":
        return WarpBackend(scene, log, log.drive.frames if frames is None else frames, quality_named(quality))
    return SurfelBackend(scene, log.drive, quality_named(quality))


@dataclass(frozen=True)
class LogSource:
    """Makes one of the `UNTRAINED` renderers of a drive, from the log that it was recorded in; pickles. ``frames`` are those
    whose sweeps and images may be looked at; all where None."""

    name: str
    log: Path
    drive: Drive
    frames: tuple[int, ...] | None = None
    quality: str = "balanced"
    draw: int | None = None
    shadows: bool = False

    def __call__(self) -> DriveRenderer:
        """Load the log's surfels; they are made where they are not kept. Raises `UnisimError`."""
        log = open_log(self.log)
        scene = finished(surfels_of(log, UNTRAINED[self.name], self.frames))
        backend = untrained_backend(self.name, scene, log, self.frames, self.quality)
        return DriveRenderer(Renderer(backend, self.shadows), self.drive, self.draw)

    def captures(self) -> CaptureStates:
        """See `Source.captures`."""
        states = DriveStates(self.drive, parked_boxes(open_log(self.log).drive))
        return CaptureStates(states, reach_of(self.shadows), sees_all=self.name == "warp")

    def hashes(self) -> dict[str, str]:
        """What stands for a trained scene's digest is that of log and settings."""
        return {"": build_key(open_log(self.log), UNTRAINED[self.name], self.frames), **mesh_hashes(self.drive)}

    def steps(self) -> Iterator[Step]:
        """Make the surfels, step by step, where they are not kept. Raises `UnisimError`."""
        steps = surfels_of(open_log(self.log), UNTRAINED[self.name], self.frames)
        return (step for step in steps if isinstance(step, Step))


class Source(Protocol):
    """Makes a renderer in any process, and pickles."""

    def __call__(self) -> DriveRenderer:
        """The renderer."""
        ...

    def hashes(self) -> dict[str, str]:
        """Digests of what it renders, by the name that looks have for it, "" for the drive's own."""
        ...

    def captures(self) -> CaptureStates:
        """What of the world each capture depends on; the renderer sees the same."""
        ...

    def steps(self) -> Iterator[Step]:
        """What has to be made once before, step by step."""
        ...


class RendererSpec(NamedTuple):
    """What a renderer is made for: a log's folder, a trained scene's, the edited drive, settings, frames to learn from."""

    log: Path
    scene: Path | None
    drive: Drive
    quality: str
    device: str
    draw: int | None
    shadows: bool
    frames: tuple[int, ...] | None


def method_of(scene: Path) -> str:
    """The method that a scene was trained by. Raises `SceneError`."""
    return ModelConfig.from_dict(read_scene_header(scene).model).method


def _trained(name: str, spec: RendererSpec) -> Source:
    if spec.scene is None:
        raise ScenarioError(f'{spec.log}: has no trained scene to render with; train one with "unisim train"')
    if (method := method_of(spec.scene)) != name:
        raise ScenarioError(f'{spec.scene}: was trained by the method "{method}", not by "{name}"')
    return SceneSource(spec.scene, spec.drive, spec.quality, spec.device, spec.draw, spec.shadows)


def _untrained(name: str, spec: RendererSpec) -> Source:
    return LogSource(name, spec.log, spec.drive, spec.frames, spec.quality, spec.draw, spec.shadows)


class RendererKind(NamedTuple):
    """``source`` makes a renderer's source. ``trained`` renderers see the drive as their trained scene refined it."""

    source: Callable[[RendererSpec], Source]
    trained: bool


RENDERERS: dict[str, RendererKind] = {
    **{name: RendererKind(partial(_trained, name), trained=True) for name in METHODS},
    **{name: RendererKind(partial(_untrained, name), trained=False) for name in UNTRAINED},
}
"""By the name that `unisim render --renderer` has for them."""
