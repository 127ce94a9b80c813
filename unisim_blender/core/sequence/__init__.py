"""Many frames into a folder: what is rendered of a drive, and how, resumably. The renderer is given."""
