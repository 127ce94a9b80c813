"""What an edit by hand does to objects and their keys: moving, retiming, muting, reverting, variants."""
