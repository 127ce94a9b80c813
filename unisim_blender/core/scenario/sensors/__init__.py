"""A scenario's sensors: as its document states them, and applied to a log's."""
