"""Training of a scene."""
