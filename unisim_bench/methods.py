"""Methods that are measured: a tracer at a quality, in a process that has one instruction set and kernels or not."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from importlib.util import find_spec

from unisim_blender.core.render.quality import QUALITY, Quality

VARIANTS = ("portable", "avx2", "avx512")
DEFAULT = "native"
"""The process whose instruction set the library chose itself."""
EAGER, KERNELS = "torch eager", "torch with kernels"
ENVIRONMENTS = {
    DEFAULT: {},
    KERNELS: {},
    EAGER: {"UNISIM_NATIVE": "0"},
    **{variant: {"UNISIM_NATIVE_VARIANT": variant} for variant in VARIANTS},
}
"""Environment variables that each process is started with."""
TYPICAL = "balanced"
DOUBLED = replace(QUALITY["reference"], samples=32, background=16)
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


def all_methods(variants: dict[str, str], threads: int, torch: bool) -> list[BenchmarkMethod]:
    """Methods for processes whose instruction sets are ``variants``. One that another has already is
    not measured again."""
    own = variants[DEFAULT]
    found = [
        BenchmarkMethod(f"native {name}", DEFAULT, "compiled", quality, own, threads)
        for name, quality in QUALITY.items()
    ]
    if threads > 1:
        found.append(BenchmarkMethod(f"native {TYPICAL}, 1 thread", DEFAULT, "compiled", QUALITY[TYPICAL], own, 1))
    for variant in VARIANTS:
        if variants.get(variant) == variant and variant != own:
            name = f"native {TYPICAL}, {variant}"
            found.append(BenchmarkMethod(name, variant, "compiled", QUALITY[TYPICAL], variant, threads))
    if torch:
        # every pixel by a ray of its own: what the others are held against
        every = replace(QUALITY[TYPICAL], lattice=1)
        found += [
            BenchmarkMethod(KERNELS, KERNELS, "torch", every, own, threads, whole=False),
            BenchmarkMethod(EAGER, EAGER, "torch", every, "torch", threads, whole=False),
        ]
    return found
