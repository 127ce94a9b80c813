"""One frame's files: pictures, sweeps and labels, and films of many."""
