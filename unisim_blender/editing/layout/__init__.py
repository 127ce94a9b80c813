"""Layouts and colours of what is drawn: speed graph, presence timeline, charts, LiDAR points."""
