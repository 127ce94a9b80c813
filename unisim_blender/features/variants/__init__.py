"""Variants: several scenarios of one drive in a file."""
