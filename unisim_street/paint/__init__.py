"""What surfaces look like: patterns, materials, and the light on them."""
