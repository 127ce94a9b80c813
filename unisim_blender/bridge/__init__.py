"""Between core's types and what stands in a Blender scene. Blender's axes appear here and nowhere else."""
