"""Preset ``hd``."""

from dataclasses import replace

from .ours import ours
from .preset import register
from .small import SMALL

# a ray for nine pixels; with kernels of one pixel rays can be learnt from scattered, which is worth more than
# looking aside
HD = register(ours("hd", "HD", "For images that are learnt and rendered 1920 wide", replace(SMALL.model, upsample=3)))
