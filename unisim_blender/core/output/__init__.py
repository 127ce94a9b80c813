"""One frame's files: images, sweeps and labels, and films of many."""
