"""Scores of what a driver planned, beside those of what it drove."""
