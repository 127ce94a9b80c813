"""The world at a moment, and where such moments come from."""
