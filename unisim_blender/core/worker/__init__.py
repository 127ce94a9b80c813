"""A process that renders for Blender: requests come through a pipe, pixels go back in files."""
