"""What users see in the sidebar, one file a subject: drawing only."""

from . import actor, drive, edits, output, rig, variants

MODULES = (drive, actor, edits, variants, rig, output)
