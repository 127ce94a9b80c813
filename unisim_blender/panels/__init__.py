"""What users see in the sidebar, one file a subject: drawing only."""

from . import actor, actors, batch, drive, edits, motion, output, rig, sensors, simulation, statusbar, variants

MODULES = (drive, actors, actor, motion, edits, variants, rig, sensors, output, simulation, batch, statusbar)
