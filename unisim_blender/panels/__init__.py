"""What users see in the sidebar, one file a subject: drawing only."""

from . import actor, drive, edits, motion, output, rig, sensors, statusbar, variants

MODULES = (drive, actor, motion, edits, variants, rig, output, sensors, statusbar)
