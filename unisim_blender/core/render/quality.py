"""Render qualities by name, from fast to exact."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..errors import SceneError


@dataclass(frozen=True)
class Quality:
    """Approximations that a tracer and a renderer may make to save work, and where.

    ``samples`` multiplies the scene's own samples a ray where they are placed by quantiles, as torch does everywhere
    and the compiled tracer with ``stride_m`` 0. ``background`` multiplies those of the background model. The others
    steer the march to surfaces: ``stride_m`` is its longest step, ``relaxation`` how much longer than the distance a
    step may be, ``splits`` how often the interval that stops most of a ray is halved, ``opaque`` the transmittance
    behind which nothing is looked at. ``lattice`` is how many pixels apart an image is traced at first; in between it
    is where the corners' colours differ by more than ``spread`` and the middle's is not what they predict. In images of
    the training's size ``native_spread`` does the same for blocks of two pixels; with 0 every pixel is traced.
    """

    samples: float = 1.0
    background: float = 1.0
    stride_m: float = 0.2
    relaxation: float = 2.5
    splits: int = 3
    opaque: float = 3e-3
    lattice: int = 4
    spread: float = 0.025
    native_spread: float = 0.0


QUALITIES = {
    "fast": Quality(
        samples=0.67, stride_m=0.4, relaxation=4.0, splits=2, opaque=1e-2, spread=0.05, native_spread=0.016
    ),
    "balanced": Quality(native_spread=0.008),
    "fine": Quality(
        samples=2.0,
        background=4.0,
        stride_m=0.035,
        relaxation=1.25,
        splits=4,
        opaque=1e-3,
        lattice=2,
        spread=0.015,
        native_spread=0.0075,
    ),
    "reference": Quality(samples=4.0, stride_m=0.0, opaque=1e-4, lattice=1),
}
"""Qualities by name, the cheapest first. ``reference`` takes the same samples as torch."""

ERROR_BOUND_QUALITIES = {
    # the bounds are of rays: they do not count what a lattice leaves out
    "fast": replace(QUALITIES["fast"], native_spread=0.0),
    "balanced": replace(QUALITIES["balanced"], native_spread=0.0),
    "step 10 cm": Quality(samples=1.5, background=2.0, stride_m=0.1, relaxation=1.5, splits=4, opaque=1e-3),
    "step 5 cm": Quality(
        samples=2.0, background=4.0, stride_m=0.05, relaxation=1.0, splits=4, opaque=1e-3, lattice=4, spread=0.02
    ),
    "step 3 cm": Quality(
        samples=4.0, background=4.0, stride_m=0.03, relaxation=0.7, splits=5, opaque=3e-4, lattice=2, spread=0.02
    ),
    "step 1 cm": Quality(samples=8.0, background=8.0, stride_m=0.01, relaxation=0.35, splits=6, opaque=1e-4, lattice=1),
    "8 times the samples": replace(QUALITIES["reference"], samples=8.0, background=8.0),
}
"""Qualities that an error bound chooses from, by name, the cheapest and least exact first."""

TRUTH_QUALITY = replace(QUALITIES["reference"], samples=16.0, background=8.0)
"""Reference quality, which errors are measured against."""


def quality_named(name: str) -> Quality:
    """Return the quality of that name. Raises `SceneError`, which lists the names."""
    if name not in QUALITIES:
        raise SceneError(f"no quality {name!r}: there are {', '.join(QUALITIES)}")
    return QUALITIES[name]
