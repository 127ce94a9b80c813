"""What users see in the sidebar, one file a subject: drawing only."""

from . import actor, actors, drive, output, rig

MODULES = (drive, actors, actor, rig, output)
