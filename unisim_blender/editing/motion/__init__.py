"""Motion of actors: speed and acceleration, plausibility, ground, arc length, durations."""
