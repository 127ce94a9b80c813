"""Settings of a benchmark, and the methods that are measured: a tracer at a quality, in a process with an instruction set
of its own, with kernels or without."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from importlib.util import find_spec

from unisim_blender.core.render.quality import QUALITIES, Quality


@dataclass(frozen=True)
class Settings:
    """Widths are of images, in pixels. Images are compared with the truth in ``windows`` (columns, rows) of ``window``
    (width, height) pixels, sweeps in every ``column_step``-th column. ``copies`` are numbers of added actors,
    ``shares`` of the frame's area are rendered again alone; both at ``growth_width``. What a state costs is measured
    ``state_repeats`` times with ``state_actors`` actors, for a sweep and for an image of ``state_width``. Of the closed
    loop, ``loop_steps`` steps are measured at every quality, with images of ``loop_width``."""

    rounds: int = 3
    widths: tuple[int, ...] = (640, 960, 1920)
    windows: tuple[int, int] = (3, 2)
    window: tuple[int, int] = (96, 64)
    column_step: int = 16
    growth_width: int = 640
    growth_widths: tuple[int, ...] = (320, 480, 640, 960, 1280, 1920)
    copies: tuple[int, ...] = (0, 1, 10, 50, 100, 200)
    shares: tuple[float, ...] = (0.01, 0.05, 0.2, 1.0)
    memory_width: int = 1920
    state_actors: int = 100
    state_repeats: int = 30
    state_width: int = 640
    loop_steps: int = 8
    loop_width: int = 640


QUICK = Settings(
    rounds=1,
    widths=(640,),
    windows=(2, 2),
    growth_width=320,
    growth_widths=(160, 320, 640),
    copies=(0, 1, 50),
    memory_width=1920,
    loop_steps=3,
)
"""A look in a minute or two: nothing of it is to be quoted."""
VARIANTS = ("portable", "avx2", "avx512")
DEFAULT = "native"
"""The process whose instruction set the library chose itself."""
GPU = "gpu"
"""The tracer of a GPU by its native kernels, and the process that it runs in."""
EAGER, KERNELS = "torch eager", "torch with kernels"
ENVIRONMENTS = {
    DEFAULT: {},
    KERNELS: {},
    GPU: {},
    EAGER: {"UNISIM_NATIVE": "0"},
    **{variant: {"UNISIM_NATIVE_VARIANT": variant} for variant in VARIANTS},
}
"""Environment variables that each process is started with."""
TYPICAL = "balanced"
DOUBLED = replace(QUALITIES["reference"], samples=32, background=16)
"""How far the truth is from twice its samples is the truth's own uncertainty."""


@dataclass(frozen=True)
class BenchmarkMethod:
    """``process`` is a name of ENVIRONMENTS, ``variant`` the instruction set there. What is not ``whole`` is rendered
    in the windows alone, and its time scaled by rays."""

    name: str
    process: str
    tracer: str
    quality: Quality
    variant: str
    threads: int
    whole: bool = True


def cores() -> int:
    """How many this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def has_torch() -> bool:
    """Whether torch is installed; it is not imported."""
    return find_spec("torch") is not None


def all_methods(variants: dict[str, str], threads: int, torch: bool, gpu: bool = False) -> list[BenchmarkMethod]:
    """Methods for processes whose instruction sets are ``variants``, and for a GPU where there is one. One that another has
    already is not measured again."""
    own = variants[DEFAULT]
    methods = [
        BenchmarkMethod(f"native {name}", DEFAULT, "compiled", quality, own, threads)
        for name, quality in QUALITIES.items()
    ]
    if threads > 1:
        methods.append(BenchmarkMethod(f"native {TYPICAL}, 1 thread", DEFAULT, "compiled", QUALITIES[TYPICAL], own, 1))
    for variant in VARIANTS:
        if variants.get(variant) == variant and variant != own:
            name = f"native {TYPICAL}, {variant}"
            methods.append(BenchmarkMethod(name, variant, "compiled", QUALITIES[TYPICAL], variant, threads))
    if gpu:
        methods += [
            BenchmarkMethod(f"GPU {name}", GPU, GPU, quality, own, threads) for name, quality in QUALITIES.items()
        ]
    if torch:
        # every pixel by a ray of its own: what the others are held against
        every = replace(QUALITIES[TYPICAL], lattice=1)
        methods += [
            BenchmarkMethod(KERNELS, KERNELS, "torch", every, own, threads, whole=False),
            BenchmarkMethod(EAGER, EAGER, "torch", every, "torch", threads, whole=False),
        ]
    return methods
