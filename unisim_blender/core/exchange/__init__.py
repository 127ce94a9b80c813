"""Scenarios in other programs' formats, written and read. Logs in other layouts are `convert`'s."""
