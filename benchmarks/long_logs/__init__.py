"""Long drives in several layouts, made of a few sweeps and images again and again: what `long_layouts.py` measures on."""
