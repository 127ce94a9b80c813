"""Motion of actors and the ego vehicle: paths, speed, handles."""
