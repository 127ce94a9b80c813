"""Images that are traced where they must be, and interpolated in between."""
