"""The jobs of a batch: files that they are read from, sweeps, and the jobs of both."""
