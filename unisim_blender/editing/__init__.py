"""Editing a drive without Blender: plain data in, scenarios, findings, words and layouts out."""
