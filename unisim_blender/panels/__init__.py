"""What users see in the sidebar, one file a subject: drawing only."""

from . import actor, drive, output, rig, sensors

MODULES = (drive, actor, rig, sensors, output)
