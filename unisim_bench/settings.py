"""How large and how often: what a measurement's length is made of."""

from __future__ import annotations

from dataclasses import dataclass


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
