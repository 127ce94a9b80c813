"""A procedural street that is known exactly: its layout, its surfaces, and what any sensor sees of
it, edited or not."""
