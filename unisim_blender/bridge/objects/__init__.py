"""Objects of a drive in a Blender scene: finding and making them, their keys, trajectories, meshes and names."""
