"""Rays traced with torch: the reference, the tracer that training renders with, and the one of every
device but the CPU."""
