"""A trained scene on disk."""
