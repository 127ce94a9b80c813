"""A Blender scene sampled at frames of the log: by stepping, from keys alone, or beside the frame that is shown."""
