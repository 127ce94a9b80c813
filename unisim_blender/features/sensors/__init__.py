"""Cameras, LiDARs and rig presets."""
