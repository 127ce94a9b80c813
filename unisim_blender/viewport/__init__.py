"""Drawing in the 3D view: the rendered image, its comparison with the recorded one, overlays."""
