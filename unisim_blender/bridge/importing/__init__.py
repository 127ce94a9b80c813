"""A recorded drive, a scenario's edits, recorded images and rig presets put into a Blender scene."""
