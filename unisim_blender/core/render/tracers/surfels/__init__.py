"""Surfels of a log's LiDAR returns: a renderer that needs no training (LiDARsim, Manivasagam et al., 2020)."""
