"""LiDAR points in the 3D view."""
