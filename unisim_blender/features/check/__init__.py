"""The check of a scenario for implausible edits."""
