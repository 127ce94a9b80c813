"""Constants on which all implementations of rendering must agree."""

from __future__ import annotations

DECAY_PER_M = 0.15
"""Rate, 1 / metres, at which occupied voxels hide those behind them: low, as a ray can graze the road for tens of
metres."""
QUANTILE_FLOOR = 0.05
"""Share of the second set of samples that is spread evenly over the quantiles."""
OPAQUE_TRANSMITTANCE = 1e-3
"""Transmittance under which nothing behind is computed."""
EMPTY_M = 10.0
"""The signed distance that stands for empty space."""
EMPTY_LOG_DENSITY = -10.0
"""The logarithm of the density, 1 / metres, that stands for empty space."""
COVERED_TRANSMITTANCE = 1e-6
"""Transmittance of a mesh that covers a ray."""
GROUND_CELL_M = 1.0
"""Edge of the cells of the ground's heights, metres."""
GROUND_CLEARANCE_M = 0.1
"""Height above the ground, metres, above which a point does not belong to it."""
GROUND_LIGHT_RADIUS_M = 0.6
"""Distance, metres, of the four places whose mean is the ground's appearance under an actor: a single one may be a lane
mark."""
MAX_LOG_DENSITY = 8.0
"""Upper bound of log densities, of the background model, too; densities in 1 / metres."""
NORMAL_STEP_M = 0.03
"""Step, metres, of the differences of signed distances that give a normal."""
SYMMETRIC_CLASSES = ("car", "truck", "bus", "van", "vehicle", "trailer", "towed", "motorcycle", "bicycle", "scooter")
"""Words in the names of classes that are symmetric about their length, so that one side shows the other."""
