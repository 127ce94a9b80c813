"""Features of the extension, a folder each: operators, panel, properties and task side by side."""
