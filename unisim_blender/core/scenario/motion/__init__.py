"""Poses and trajectories: as a scenario writes them, and made from each other."""
