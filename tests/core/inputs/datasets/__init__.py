"""Logs of other layouts with faults: their files in the views that such faults are drawn in, and a test for each layout."""
