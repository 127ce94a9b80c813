"""The space that the static field fills: its volume, its ground, its occupied voxels."""
