"""One room a format: how logs, runs and scenarios of other programs are read and written."""
