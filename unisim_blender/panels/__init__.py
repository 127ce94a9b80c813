"""What users see in the sidebar, one file a subject: drawing only."""

from . import actor, drive, motion, output, rig

MODULES = (drive, actor, motion, rig, output)
