"""Images in Blender: recorded beside rendered ones, parts of a view, finished sequences."""
