"""Actors of a simulation: models of how they move, and what these know of the recorded drive."""

from . import models as models  # so that all are registered
