"""Whether a configuration's values can be built at all: a model of them is made only afterwards."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal, get_args, get_origin, get_type_hints

from ..errors import SceneError, short
from .config import ModelConfig
from .shapes import actor_grid, background_grid, cells_of, static_grid
from .space.volume import Volume

MOST = 1 << 24
"""No number of a configuration is larger: what asks for more is broken, and would fill the memory before
anything noticed."""
MOST_OF = {
    "levels": 64, "log2_table": 28, "hidden": 1024, "features": 1024, "latent": 4096, "hyper_hidden": 4096,
    "hyper_layers": 16,
    "decoder_channels": 1024, "decoder_blocks": 64, "decoder_kernel": 31, "upsample": 16,
    **dict.fromkeys(("static_proposals", "static", "actor_proposals", "actor", "background_proposals", "background"),
    1 << 16),
}  # fmt: skip
"""The same of whole numbers by their name."""
LEAST_OF = {"coarsest": 1e-3, "finest": 1e-3, "voxel_m": 1e-3}
MOST_ENTRIES = 1 << 27
"""Of tables and of networks, all together: some ten times what the largest preset has."""
MOST_VOXELS = 1 << 28
"""A volume of 900 by 900 metres has so many of half a metre; each is two bytes of a scene that is rendered."""


def check_config(config: Any, where: str) -> None:
    """Check a configuration's numbers and words (a dataclass, nested ones included). SceneError names ``where``
    and the value."""
    hints = get_type_hints(type(config))
    for field in dataclasses.fields(config):
        value, kind, place = getattr(config, field.name), hints[field.name], f"{where}.{field.name}"
        if dataclasses.is_dataclass(value):
            check_config(value, place)
        elif get_origin(kind) is Literal:
            if value not in get_args(kind):
                raise SceneError(f"{place} is {short(value)}, not one of {', '.join(map(repr, get_args(kind)))}")
        elif kind is int:
            most = MOST_OF.get(field.name, MOST)
            if not (isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= most):
                raise SceneError(f"{place} is {short(value)}, not a whole number from 1 to {most}")
        elif kind is float:
            sound = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
            if not (sound and 0 < value <= MOST):
                raise SceneError(f"{place} is {short(value)}, not a number above 0 and up to {MOST}")
            if value < LEAST_OF.get(field.name, 0):
                raise SceneError(f"{place} is {short(value)}, below {LEAST_OF[field.name]:g}")


def check_sizes(config: ModelConfig, volume: Volume, where: str) -> None:
    """Check that a model of a checked configuration fits into memory. SceneError names ``where``."""
    for name in ("background_grid", "actor_grid"):
        grid = getattr(config, name)
        if min(grid.coarsest, grid.finest) < 1:
            raise SceneError(
                f"{where}.{name} has {min(grid.coarsest, grid.finest):g} cells along an axis, not one at least"
            )
    shapes = {
        "static_grid": static_grid(config, volume.size_m),
        "background_grid": background_grid(config),
        "actor_grid": actor_grid(config),
    }
    entries = {name: shape.rows * shape.features for name, shape in shapes.items()}
    # a hypernetwork's last layer has a row for each of them
    entries["actor_grid"] *= config.hyper_hidden if config.actors == "hypernetwork" else 1
    entries["voxel_m"] = math.prod(cells_of(volume.size_m, config.voxel_m))
    widest = max(shape.width for shape in shapes.values())
    entries["hidden"] = config.hidden * (widest + config.features) + config.hyper_hidden**2 * config.hyper_layers
    entries["decoder_channels"] = config.decoder_blocks * config.decoder_channels**2 * config.decoder_kernel**2
    for name, count in entries.items():
        most = MOST_VOXELS if name == "voxel_m" else MOST_ENTRIES
        if count > most:
            raise SceneError(f"{where}.{name} asks for {count} numbers in all, more than the {most} that are read")
