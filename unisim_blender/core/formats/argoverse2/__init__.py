"""Argoverse 2, sensor dataset."""
