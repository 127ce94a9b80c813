"""Mesh actors in a drive: models and their files, hits of rays, lighting."""
