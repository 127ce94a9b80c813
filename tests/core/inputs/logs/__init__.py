"""Logs, what their sensors say, and pickles with faults."""
