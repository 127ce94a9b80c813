"""Writes a recorded or rendered drive as a log in another layout, capture by capture."""
