"""Baseline ``ngp``, after Instant-NGP (Mueller et al., 2022): one density for everything that is
there, moving or not."""

from dataclasses import replace

from .baseline import SHAPES, baseline
from .preset import register

NGP = register(
    baseline("ngp", "Instant-NGP", "Baseline: one field for everything, without actors", replace(SHAPES, actors="none"))
)
