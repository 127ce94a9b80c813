"""A scenario's times: as its document states them, as captures, and beyond the recording."""
