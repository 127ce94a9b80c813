"""Drives: imported, shown, exported as scenarios."""
