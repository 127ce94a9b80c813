"""What a window shows: its areas, the selection, the size of sensors, redrawing."""
