"""Appearance of surfaces: patterns, materials, and the light on them."""
