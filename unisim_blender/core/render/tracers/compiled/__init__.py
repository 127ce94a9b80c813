"""Rendering with numpy and the compiled kernels alone, which Blender's own Python can run. Torch is its
specification."""
