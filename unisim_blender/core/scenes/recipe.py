"""Recipes from which any process, on any machine, makes a renderer that gives the same bytes.

A recipe is made from what a scenario and a command line name. It pickles; what computes is imported and loaded by `load`.
A trained scene's backend is the compiled kernels where they take all of it, or else torch.
"""

from __future__ import annotations

import os
import platform
import socket
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from .. import cuda_driver, native
from ..errors import UnisimError
from ..geometry import FloatArray
from ..native import VARIANT_VARIABLE
from ..processes import WORKER_VARIABLE
from ..registry import Registry
from ..render.captures import CaptureStates
from ..render.code_identity import code_identity
from ..render.quality import quality_named
from ..render.renderer import Renderer
from ..render.tracer import Backend
from ..render.tracers.compiled.gpu import GpuBackend, GpuScene
from ..render.tracers.compiled.scene import CompiledScene, not_taken
from ..render.tracers.compiled.tracer import CompiledBackend
from ..render.tracers.surfels.build import Step
from ..world.drive import Drive
from .scene import Scene

Loaded = dict[tuple[str, str, Scene], Any]
"""Scenes that are loaded, by what computes them, device, and scene."""
COMPILED, GPU, TORCH = "compiled", "gpu", "torch"


def backend_name(device: str, scenes: Sequence[Scene] = ()) -> str:
    """Return what computes scenes together on a device: `COMPILED`, `GPU` or `TORCH`. Raises `SceneError`."""
    if native.library() is None or any(not_taken(scene.config) for scene in scenes):
        return TORCH
    if device.startswith("cuda") and not cuda_driver.missing():
        return GPU
    return COMPILED if device == "cpu" else TORCH


def used_device(device: str, scenes: Sequence[Scene] = ()) -> str:
    """Return the device that computes scenes together where ``device`` is asked for: the CPU, for scenes that kernels of a GPU
    do not take. Raises `UnisimError` for a device that does not work here."""
    kind, colon, text = device.partition(":")
    if kind not in ("cpu", "cuda", "mps") or (colon and not text.isdecimal()):
        raise UnisimError(f"--device {device}: is none of cpu, cuda, cuda:0, cuda:1, mps and auto")
    if (name := backend_name(device, scenes)) == GPU:
        gpu_of(device)
    if name != TORCH or kind == "cpu" or torch_device() == kind:
        return device
    if kind == "cuda" and not cuda_driver.missing():
        return "cpu"
    why = cuda_driver.missing() if kind == "cuda" else "Metal needs macOS, and torch"
    helps = find_spec("torch") is None and (kind == "mps" or cuda_driver.driver() is not None)
    raise UnisimError(f"--device {device}: {why}", remedy="interpreter" if helps else "")


def torch_device() -> str:
    """Return the best device of torch: "cuda", "mps", or "cpu", which is also what there is without torch."""
    try:
        import torch
    except ModuleNotFoundError:
        return "cpu"
    return "cuda" if torch.cuda.is_available() else "mps" if torch.backends.mps.is_available() else "cpu"


def gpu_of(device: str) -> cuda_driver.Gpu:
    """Return the GPU of a device: its own of "cuda:1", and of "cuda" one for each worker of this machine in turn. Raises
    `UnisimError`."""
    _, colon, text = device.partition(":")
    number = int(text) if colon else int(os.environ.get(WORKER_VARIABLE, "0")) % max(cuda_driver.count(), 1)
    return cuda_driver.gpu(number)


def environment(device: str, scenes: Sequence[Scene] = ()) -> dict[str, str]:
    """Return what else equal bytes depend on: machine, instruction set, libraries that compute. ModuleNotFoundError names the
    one that is not installed."""
    common = {"machine": platform.machine(), "device": device, "numpy": np.__version__}
    if (name := backend_name(device, scenes)) != TORCH:
        kernels = {"kernels": str(native.ABI_VERSION), "instruction_set": native.variant()}
        return {**common, **kernels, **({"gpu": gpu_of(device).name} if name == GPU else {})}
    import torch

    return {**common, "torch": torch.__version__, "instruction_set": torch.backends.cpu.get_cpu_capability()}


def load_backend(
    scene: Scene,
    others: Mapping[str, Scene] | None = None,
    quality: str = "balanced",
    device: str = "cpu",
    loaded: Loaded | None = None,
) -> Backend:
    """Load a scene onto a device, and those that actors are inserted from, by the names that appearances have for them.

    ``loaded`` holds the scenes that an earlier call has loaded, and afterwards those of this one. Raises `SceneError`.
    """
    every = {"": scene, **(others or {})}
    device = used_device(device, tuple(every.values()))
    name = backend_name(device, tuple(every.values()))
    before, now, scenes = loaded or {}, Loaded(), {}
    for known_as, opened in every.items():
        key = name, device, opened
        scenes[known_as] = now[key] = before.get(key) or _load(name, opened, device)
    if loaded is not None:
        loaded.clear()
        loaded.update(now)
    own, of_quality = scenes.pop(""), quality_named(quality)
    if name == COMPILED:
        return CompiledBackend(own, of_quality, scenes)
    if name == GPU:
        return GpuBackend(own, of_quality, scenes)
    from ..render.tracers.torch.tracer import TorchBackend

    return TorchBackend(own, of_quality, scenes)


def _load(name: str, scene: Scene, device: str) -> Any:
    if name == COMPILED:
        return CompiledScene(scene.path, header=scene.header)
    if name == GPU:
        return GpuScene(CompiledScene(scene.path, header=scene.header), gpu_of(device))
    from ..model.checkpoint import load_scene

    return load_scene(scene.path, device, scene.header)


@dataclass(frozen=True, eq=False)
class RendererRecipe:
    """How the renderer ``method`` is made: of the log's folder or a trained scene, with the scenes ``others`` that actors were
    inserted from, by their names in `Appearance`.

    ``frames`` of the log are learnt from, all where None. ``code`` is the digest of the code that planned, ``environment`` that
    of its machine.
    """

    method: RenderMethod
    log: Path
    scene: Scene | None
    others: Mapping[str, Scene]
    world_origin: FloatArray
    quality: str
    device: str
    shadows: bool
    frames: tuple[int, ...] | None
    code: str
    environment: Mapping[str, str]
    fill: str = "none"
    detail: bool = False

    @property
    def is_filled(self) -> bool:
        """Whether ground and façades that nobody saw are filled, by itself or before a fixer draws."""
        return self.fill != "none"

    def check(self) -> None:
        """Check that this machine renders the bytes of the one that planned. Raises `UnisimError`."""
        check_code(self.code)
        check_environment(self.environment, self.device, scenes_of(self.scene, self.others))

    def load(self) -> Renderer:
        """Check, and load the renderer. Raises `UnisimError`."""
        self.check()
        return self.method.load(self)

    def steps(self) -> Iterator[Step]:
        """Do what has to be done once before renderers are loaded, step by step. Raises `UnisimError`."""
        return self.method.steps(self)


class RenderMethod(ABC):
    """A renderer by its name, as `unisim render --renderer` has it. It pickles.

    ``about`` says in a few words what it renders. Those that are ``trained`` need a trained scene, and see the drive as the scene
    refined it.
    """

    name: str
    about: str
    trained: bool = False

    @abstractmethod
    def load(self, recipe: RendererRecipe) -> Renderer:
        """Load the renderer; what computes is imported here. Raises `UnisimError`."""

    @abstractmethod
    def digests(self, recipe: RendererRecipe, drive: Drive) -> dict[str, str]:
        """Return digests of what frames of a drive depend on besides the drive and the settings, by `Appearance.scene` and
        `Appearance.mesh`, "" for the drive's own scene."""

    @abstractmethod
    def states(self, recipe: RendererRecipe, drive: Drive) -> CaptureStates:
        """Return what of the world each capture of a drive depends on."""

    def check_inputs(self, log: Path, scene: Scene | None) -> None:
        """Check that it can render a log or a scene. Raises `UnisimError`."""
        return

    def steps(self, recipe: RendererRecipe) -> Iterator[Step]:
        """Do what has to be done once before, step by step."""
        return iter(())


RENDERERS: Registry[RenderMethod] = Registry(
    "a renderer", "unisim_blender.renderers", ("name", "trained", "about", "load", "digests", "states")
)
"""The registered renderers by the name that `unisim render --renderer` has for them."""
register = RENDERERS.register


def scenes_of(scene: Scene | None, others: Mapping[str, Scene]) -> tuple[Scene, ...]:
    """Return all trained scenes that a renderer shows, the drive's own first."""
    return (*(() if scene is None else (scene,)), *others.values())


def check_code(planned: str) -> None:
    """Check that this machine's unisim_blender has the digest of the one that planned. Raises `UnisimError`."""
    if code_identity()["sha256"] != planned:
        raise UnisimError(
            f"{socket.gethostname()}: its unisim_blender is another one than that of the machine that planned this; "
            "install the same version on all machines"
        )


def check_environment(planned: Mapping[str, str], device: str, scenes: Sequence[Scene] = ()) -> None:
    """Check that trained scenes are rendered here, on a device, as where that was planned, whose `environment` this was. Raises
    `UnisimError`, which names this machine and what differs."""
    if differing := difference(planned, environment(device, scenes)):
        raise UnisimError(
            f"{socket.gethostname()}: renders other bytes than the machine that planned this: its {differing}; "
            "install the same versions on all machines, and have all use one instruction set, by "
            f"{VARIANT_VARIABLE}, or of torch by ATEN_CPU_CAPABILITY"
        )


def difference(planned: Mapping[str, str], here: Mapping[str, str]) -> str:
    """Say in which member two environments differ; "" where they are equal."""
    for name in sorted(planned.keys() | here.keys()):
        if planned.get(name) != here.get(name):
            return f"{name} is {here.get(name)}, not {planned.get(name)}"
    return ""


def pick_device(name: str, trains: bool = False) -> str:
    """Return a device by its name; "auto" is the best there is here to render, or to train, which takes torch's. A warning says
    why a GPU that is here does not render."""
    if name != "auto":
        return name
    if trains or cuda_driver.driver() is None:
        return torch_device()
    try:
        gpu_of("cuda")
        return "cuda"
    except UnisimError as error:
        device = "cpu" if cuda_driver.missing() == "" else torch_device()
        warnings.warn(f"{'torch' if device == 'cuda' else 'the CPU'} renders: {error}", stacklevel=2)
        return device
