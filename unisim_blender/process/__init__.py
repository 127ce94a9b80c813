"""Processes beside Blender: the worker, tasks in the background, and the Python that they run in."""
