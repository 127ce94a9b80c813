"""Effects of edits by hand on objects and their keys: moving, retiming, muting, reverting, variants."""
