"""Rendered sequences and their results."""
