"""Sensors on the vehicle: mounts and times, where they recorded, directions, outlines and facts."""
