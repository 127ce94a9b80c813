"""A log's LiDAR returns as small faces that rays hit: a renderer that needs no training (LiDARsim,
Manivasagam et al., 2020)."""
