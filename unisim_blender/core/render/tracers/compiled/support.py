"""Which configurations the kernels trace. Torch's tracer takes them all."""

from __future__ import annotations

from ....model.config import ModelConfig

TAKEN = {"density": ("logistic", "unisim"), "colour": ("decoded",), "actors": ("hypernetwork", "tables")}
"""Values that the kernels know."""


def not_taken(config: ModelConfig) -> str:
    """The values of a configuration that the kernels do not know, in words; "" where they know them all."""
    return " and ".join(f"{name} {value!r}" for name in TAKEN if (value := getattr(config, name)) not in TAKEN[name])
