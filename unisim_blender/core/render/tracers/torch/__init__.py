"""Rays traced with torch: the reference, what training renders with, and every device's way but the CPU's."""
