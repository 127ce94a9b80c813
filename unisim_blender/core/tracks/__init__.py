"""Tracks of actors found in a drive's sweeps: a file for each stage, `find.py` runs them all."""
