"""The list of edits: its lines in words, and how two variants differ."""
