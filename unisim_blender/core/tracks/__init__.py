"""What a log lacks: actors found in its sweeps, and files of boxes."""
