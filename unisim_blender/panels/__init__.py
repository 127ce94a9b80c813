"""What users see: drawing only."""

from . import drive

MODULES = (drive,)
