"""What users see in the sidebar, one file a subject: drawing only."""

from . import actor, drive, edits, output, rig

MODULES = (drive, actor, edits, rig, output)
