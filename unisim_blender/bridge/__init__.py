"""Blender's side of a drive: everything that reads or changes a Blender scene. What needs no Blender
lies in `editing`."""
