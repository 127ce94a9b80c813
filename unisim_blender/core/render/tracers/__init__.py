"""Backends of the renderer: what traces rays, one a folder."""
