"""Poses of a LiDAR found from its sweeps alone."""
