"""Images in Blender: recorded beside rendered ones, parts of a view, the region that an edit changes,
finished sequences."""
