"""A moment of the world rendered into a sensor's frame; see `renderer.py`."""
