"""Images of a street drawn by Blender's path tracer."""
