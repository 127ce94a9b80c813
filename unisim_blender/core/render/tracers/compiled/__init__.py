"""Rendering with numpy and the compiled kernels alone: what Blender's own Python can run. Torch is
its specification."""
