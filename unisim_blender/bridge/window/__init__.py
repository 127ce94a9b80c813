"""Contents of a window: its areas, the selection, the size of sensors, redrawing."""
