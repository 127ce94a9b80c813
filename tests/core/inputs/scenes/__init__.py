"""Scenes, scenarios and meshes with faults."""
