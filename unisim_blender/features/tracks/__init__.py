"""Boxes of actors found, drawn, followed, corrected and saved as the log's own."""
