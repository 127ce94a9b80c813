"""Baseline ``nsg``, after Neural Scene Graphs (Ost et al., 2021): a density for what stands still, one conditioned by
latents for actors."""

from dataclasses import replace

from .baseline import SHAPES, baseline
from .preset import register

NSG = register(
    baseline("nsg", "Neural Scene Graphs", "Baseline: one network for all actors", replace(SHAPES, actors="latent"))
)
