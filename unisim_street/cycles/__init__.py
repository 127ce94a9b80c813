"""Images of a street by Cycles, through Blender's module: a process of its own, which `unisim synth` starts."""
