"""What users see in the sidebar, one file a subject: drawing only."""

from . import actor, drive, output, rig, statusbar

MODULES = (drive, actor, rig, output, statusbar)
